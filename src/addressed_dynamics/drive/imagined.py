"""The model's side of a drive: it lives on its own predictions, and says how far they are to be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.trust import Trust

COVERAGE = 0.9
"""Share of cases in which a state lies within its interval."""


@dataclass(frozen=True)
class Predicted:
    """What a model makes of a step."""

    state: Float32[np.ndarray, " observation"]
    """The state after it, at the bounds of the space where the model left them."""
    interval: Float32[np.ndarray, "2 observation"] | None
    """Where the true state lies in `COVERAGE` of cases, all steps since the start counted; None if nobody calibrated
    that, or not for as many steps."""
    trust: float | None
    """Trust in the step, in [0, 1]; None if nobody calibrated it."""
    network: int
    """The member that the step is from, or that is weighted most."""
    weights: Float32[np.ndarray, " member"]
    """What the addressing network says of all members; their sum is 1."""
    finite: bool
    """Whether the model predicted numbers; if not, the state stays."""


@dataclass(frozen=True)
class Calibrated:
    """How far a model is to be trusted, made ready for one step at a time."""

    trust: Trust

    @cached_property
    def halves(self) -> Float[Tensor, "step observation"]:
        """Half of an interval in multiples of the summed sizes of errors, for each step that was calibrated."""
        steps, width = self.trust.steps[-1], self.trust.multiples.shape[-1]
        return self.trust.half(torch.ones(1, steps, width), COVERAGE)[0]

    @cached_property
    def covers(self) -> bool:
        """Whether intervals of `COVERAGE` were calibrated: a handful of validation episodes tells less."""
        return self.trust.coverages[0] <= COVERAGE <= self.trust.coverages[-1]


class Imagined:
    """A model that is stepped. It has to be started first."""

    def __init__(
        self, model: AddressedDynamics, calibrated: Calibrated | None, bounds: Float32[np.ndarray, "2 observation"]
    ) -> None:
        """Prepare a model.

        Args:
            model: what predicts.
            calibrated: how far it is to be trusted; None if nobody knows.
            bounds: lowest and highest states of its space.
        """
        self._model = model
        self._calibrated = calibrated
        self._bounds = bounds
        self._generator = torch.Generator().manual_seed(0)

    def start(self, frames: np.ndarray, actions: np.ndarray, exogenous: np.ndarray) -> None:
        """Begin where the world is.

        Args:
            frames: the last H states, oldest first, (H, d_obs).
            actions: the actions in all of them but the last, (H - 1, ...).
            exogenous: the exogenous inputs beside those actions, (H - 1, d_exo).
        """
        self._frames = np.asarray(frames, np.float32)
        self._actions, self._exogenous = actions, exogenous
        self._steps = 0
        self._errors = torch.zeros(1, self._frames.shape[1])

    @property
    def state(self) -> Float32[np.ndarray, " observation"]:
        """The state it is in."""
        state: Float32[np.ndarray, " observation"] = self._frames[-1]
        return state

    @torch.no_grad()
    def step(self, action: np.ndarray, exogenous: Float32[np.ndarray, " exogenous"]) -> Predicted:
        """Take an action, beside exogenous inputs."""
        acted = np.concatenate([self._actions, action[None]])
        known = np.concatenate([self._exogenous, exogenous[None]])
        rows = slice(None) if self._model.features.history > 1 else 0
        observation, taken = (torch.from_numpy(np.asarray(each[rows]))[None] for each in (self._frames, acted))
        beside = torch.from_numpy(known[rows])[None] if len(exogenous) else None
        x = self._model.features.encode(observation, taken, beside)
        after, weights = self._model.step_and_probabilities(observation, taken, beside, x=x, generator=self._generator)
        interval, trust = self._expected(observation, taken, beside, after, x)
        predicted = after[0].numpy()
        finite = bool(np.isfinite(predicted).all())
        state = np.clip(predicted, *self._bounds) if finite else self.state
        self._frames = np.concatenate([self._frames[1:], state[None]])
        self._actions, self._exogenous = acted[1:], known[1:]
        return Predicted(state, interval, trust, int(weights[0].argmax()), weights[0].numpy(), finite)

    def _expected(
        self, observation: Tensor, action: Tensor, exogenous: Tensor | None, after: Tensor, x: Tensor
    ) -> tuple[Float32[np.ndarray, "2 observation"] | None, float | None]:
        """Return the interval of the state after the step, and the trust in the step."""
        if self._calibrated is None:
            return None, None
        trust = self._calibrated.trust
        found = trust.scales(self._model, observation, action, exogenous, after, x)
        self._errors = self._errors + found.error
        self._steps += 1
        share = float(trust.trust(found.signals)[0])
        if not self._calibrated.covers or self._steps > len(self._calibrated.halves):
            return None, share
        half = self._errors * self._calibrated.halves[self._steps - 1]
        return torch.cat([after - half, after + half]).numpy(), share
