"""What is compared: an experiment as it was at some time, wherever that is kept."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from jaxtyping import Float64, Int64

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.evaluation.transitions.records import ADDRESSED


class ComparisonError(AddressedDynamicsError):
    """Two versions cannot be compared: one is not there, or they have nothing in common."""


@final
@dataclass(frozen=True)
class EpisodeErrors:
    """Errors of the models of a version, episode by episode of those that were held out."""

    episode: Int64[np.ndarray, " episode"]
    """Numbers of the held-out episodes."""
    samples: Int64[np.ndarray, " episode"]
    """Points in each."""
    one_step: Mapping[str, Float64[np.ndarray, " episode"]]
    """Of each model, the sum over an episode's points of the loss of states scaled to [0, 1]."""
    rollout_episode: Int64[np.ndarray, " rollout"]
    """Episode that each rollout is from; beside an environment, its own."""
    rollouts: Mapping[str, Float64[np.ndarray, "rollout observation"]]
    """Of each model, the mean squared error of each rollout, in units of the state."""
    scale: Float64[np.ndarray, " observation"] | None
    """Range of each dimension; None in results of earlier versions."""

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> EpisodeErrors | None:
        """Return what arrays.npz of an evaluation has of it; None if it has nothing."""
        if "paired_one_step" not in arrays:
            return None
        return cls(
            arrays["paired_episode"],
            arrays["paired_samples"],
            dict(zip(arrays["paired_candidates"].tolist(), arrays["paired_one_step"], strict=True)),
            arrays["paired_rollout_episode"],
            dict(zip(arrays["paired_rollout_candidates"].tolist(), arrays["paired_rollouts"], strict=True)),
            arrays.get("paired_scale"),
        )


@final
@dataclass(frozen=True)
class Version:
    """An experiment as it was at some time; what is not known is empty."""

    name: str
    """As the user gave it."""
    what: str
    """What that is, for people."""
    experiment: str
    """Name of the experiment."""
    params: Mapping[str, Any] = field(default_factory=dict)
    """By dotted keys, those at their defaults included."""
    data: Mapping[str, str] = field(default_factory=dict)
    """Digests of its data by their paths."""
    counts: Mapping[str, float] = field(default_factory=dict)
    """How many rows, episodes and so on it has, by dotted keys of data.json."""
    code: Mapping[str, str] = field(default_factory=dict)
    """Digests of the code that it was made with by paths, or its commit."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """Headline of the evaluation, or the last metrics of a run."""
    evaluation: Mapping[str, Any] = field(default_factory=dict)
    """evaluation.json, of whichever form it had then."""
    errors: EpisodeErrors | None = None
    """Errors by episode; None where nothing is kept by episode."""
    notes: tuple[str, ...] = ()
    """What is missing or doubtful, each with what to do."""

    @property
    def candidates(self) -> Mapping[str, Any]:
        """What was measured of each model, by its name."""
        found = self.evaluation.get("candidates")
        return found if isinstance(found, dict) else {}

    @property
    def recommended(self) -> str | None:
        """Name of the model that the evaluation recommends, else of the one that it delivers; None without either."""
        for key in ("recommendation", "choice"):
            name = (self.evaluation.get(key) or {}).get("candidate")
            if name in self.candidates:
                return str(name)
        return ADDRESSED if ADDRESSED in self.candidates else None

    def label(self, candidate: str) -> str:
        """Return what people call a model."""
        return str(self.candidates.get(candidate, {}).get("label", candidate))
