"""What there is to learn from in a log: its episodes, what they earned, and where they went."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from addressed_dynamics.episodes.quality import GAP
from addressed_dynamics.episodes.transitions import ContinuousAction, SpaceSpec, Transitions


@dataclass(frozen=True)
class Spread:
    """Lowest, middle and highest of some numbers."""

    low: float
    median: float
    high: float

    @staticmethod
    def of(values: Shaped[np.ndarray, " value"]) -> Spread | None:
        """Return the spread of `values`; None if there are none."""
        return Spread(float(values.min()), float(np.median(values)), float(values.max())) if len(values) else None

    def to_json(self) -> dict[str, float]:
        """Return the numbers by name."""
        return {"min": self.low, "median": self.median, "max": self.high}


@dataclass(frozen=True)
class Experience:
    """Figures on the transitions of some logs; those of parts merge into those of the whole."""

    spec: SpaceSpec
    """What the numbers mean."""
    lengths: Int64[np.ndarray, " episode"]
    """Number of steps of each episode."""
    returns: Float64[np.ndarray, " episode"]
    """Sum of rewards of each episode."""
    ended: Mapping[str, int]
    """Number of episodes by how they ended."""
    ranges: Mapping[str, tuple[float, float]]
    """Lowest and highest value by dimension of observation, continuous action and exogenous inputs, and of the
    reward."""
    late_starts: int
    """Episodes of which the first steps are missing; inside an episode no step ever is."""
    gaps: int
    """Steps that come more than one and a half time steps after the step before them."""

    @staticmethod
    def of(transitions: Transitions, ended: Sequence[str]) -> Experience:
        """Return the figures on `transitions`.

        Args:
            transitions: whole episodes, or the parts of them that are there.
            ended: how each of the episodes ended.
        """
        slices = list(transitions.episode_slices())
        starts = np.array([rows.start for rows in slices], dtype=np.int64)
        rewards = transitions.reward.astype(np.float64)
        seconds = np.diff(transitions.time_ns) / 1e9
        same = transitions.episode[1:] == transitions.episode[:-1]
        return Experience(
            spec=transitions.spec,
            lengths=np.array([rows.stop - rows.start for rows in slices], dtype=np.int64),
            returns=np.add.reduceat(rewards, starts) if len(starts) else np.empty(0),
            ended=Counter(ended),
            ranges=_ranges(transitions) if len(transitions) else {},
            late_starts=int((transitions.step[starts] > 0).sum()),
            gaps=int((same & (seconds > GAP * transitions.spec.step_seconds)).sum()),
        )

    def merge(self, other: Experience) -> Experience:
        """Add another log with the same dimensions."""
        names = [*self.ranges, *(name for name in other.ranges if name not in self.ranges)]
        known = [{**other.ranges, **self.ranges}, {**self.ranges, **other.ranges}]
        return Experience(
            spec=self.spec,
            lengths=np.concatenate([self.lengths, other.lengths]),
            returns=np.concatenate([self.returns, other.returns]),
            ended=Counter(self.ended) + Counter(other.ended),
            ranges={name: (min(r[name][0] for r in known), max(r[name][1] for r in known)) for name in names},
            late_starts=self.late_starts + other.late_starts,
            gaps=self.gaps + other.gaps,
        )

    @property
    def transitions(self) -> int:
        """Number of transitions."""
        return int(self.lengths.sum())

    @property
    def units(self) -> dict[str, str]:
        """The unit of each dimension in `ranges` that has one."""
        action = self.spec.action
        components = action.dimensions if isinstance(action, ContinuousAction) else ()
        return {
            f"{kind}.{dimension.name}": dimension.unit
            for kind, dimensions in (
                ("observation", self.spec.observation),
                ("action", components),
                ("exogenous", self.spec.exogenous),
            )
            for dimension in dimensions
            if dimension.unit
        }

    def to_json(self) -> dict[str, Any]:
        """Return the figures as JSON-compatible values."""
        lengths, returns = Spread.of(self.lengths), Spread.of(self.returns)
        return {
            "transitions": self.transitions,
            "episodes": len(self.lengths),
            "length": lengths.to_json() if lengths else None,
            "return": returns.to_json() if returns else None,
            "ended": dict(self.ended),
            "ranges": {
                name: {"min": low, "max": high, "unit": self.units.get(name, "")}
                for name, (low, high) in self.ranges.items()
            },
            "step_seconds": self.spec.step_seconds,
            "late_starts": self.late_starts,
            "gaps": self.gaps,
        }


def _ranges(transitions: Transitions) -> dict[str, tuple[float, float]]:
    low = np.minimum(transitions.observation, transitions.next_observation).min(axis=0)
    high = np.maximum(transitions.observation, transitions.next_observation).max(axis=0)
    names = [f"observation.{name}" for name in transitions.spec.observation_names]
    ranges = {name: (float(a), float(b)) for name, a, b in zip(names, low, high, strict=True)}
    if isinstance(transitions.spec.action, ContinuousAction):
        for dimension, values in zip(transitions.spec.action.dimensions, transitions.action.T, strict=True):
            ranges[f"action.{dimension.name}"] = (float(values.min()), float(values.max()))
    for dimension, values in zip(transitions.spec.exogenous, transitions.exogenous.T, strict=True):
        ranges[f"exogenous.{dimension.name}"] = (float(values.min()), float(values.max()))
    return ranges | {"reward": (float(transitions.reward.min()), float(transitions.reward.max()))}
