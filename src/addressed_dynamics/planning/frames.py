"""What a planner knows of the past: the last frames of a model with a history."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32
from torch import Tensor

from addressed_dynamics.base.errors import PlanningError
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.simulators.arrays import Values, as_tensor, finite


class Frame(NamedTuple):
    """A step that was taken."""

    state: Float32[np.ndarray, " observation"]
    """State in which it began, in the environment's units."""
    action: np.ndarray
    """Action taken in it: () integer, or (d_act,) float32 in the environment's units."""
    exogenous: Float32[np.ndarray, " exogenous"]
    """Exogenous inputs during it, in their own units."""


class Situation(NamedTuple):
    """From where a plan begins."""

    states: Float32[np.ndarray, "frame observation"]
    """The last H states, oldest first, in the environment's units."""
    actions: np.ndarray | None
    """Actions taken in the H - 1 states before the last, (H - 1,) or (H - 1, d_act); None if H is 1."""
    exogenous: Float32[np.ndarray, "step exogenous"]
    """Exogenous inputs from the first of these frames to the end of the horizon, H - 1 + T rows."""


class Past:
    """The H - 1 frames before the current one."""

    def __init__(self, features: FeatureSpec) -> None:
        """Begin with none.

        Args:
            features: the model's.
        """
        self._features = features
        self._frames = deque[Frame](maxlen=features.history - 1)

    @property
    def missing(self) -> int:
        """How many frames are still to be seen before a plan can be made."""
        return self._features.history - 1 - len(self._frames)

    def forget(self) -> None:
        """Forget all frames: a new episode begins."""
        self._frames.clear()

    def add(self, state: Values, action: Values | int, exogenous: Values | None) -> None:
        """Add the newest frame.

        Args:
            state: state in which the step began, (d_obs,).
            action: action taken in it, an integer or (d_act,).
            exogenous: exogenous inputs during it, (d_exo,); None if the model has none.

        Raises:
            PlanningError: one of them has another shape.
            ModelError: a value is not finite.
        """
        self._frames.append(Frame(self.states(state, ()), self.actions(action, ()), self.exogenous(exogenous, ())))

    def states(self, values: Values, batch: tuple[int, ...]) -> Float32[np.ndarray, "*batch observation"]:
        """Return states, (*batch, d_obs).

        Raises:
            PlanningError: they have another shape.
            ModelError: a value is not finite.
        """
        return self._rows(values, "states" if batch else "the state", (*batch, len(self._features.spaces.observation)))

    def actions(self, values: Values | int, batch: tuple[int, ...]) -> np.ndarray:
        """Return actions as the model takes them, (*batch,) integers or (*batch, d_act) float32.

        Raises:
            PlanningError: they have another shape, or are none of the model's.
        """
        kind = self._features.spaces.action
        if not isinstance(kind, DiscreteAction):
            return self._rows(values, "actions", (*batch, len(kind.dimensions)))
        found = _as_tensor(values).numpy()
        if found.shape != batch or found.dtype.kind not in "iu" or not np.isin(found, np.arange(kind.count)).all():
            message = f"actions should be integers in 0..{kind.count - 1} of shape {batch}, but are {found.tolist()}"
            raise PlanningError(message)
        return found.astype(np.int64)

    def exogenous(self, values: Values | None, batch: tuple[int, ...]) -> Float32[np.ndarray, "*batch exogenous"]:
        """Return exogenous inputs, (*batch, d_exo), without a column if the model has none.

        Raises:
            PlanningError: they are missing, not asked for, or have another shape.
        """
        names = ", ".join(each.name for each in self._features.spaces.exogenous)
        expected = (*batch, len(self._features.spaces.exogenous))
        if values is None and not names:
            return np.empty(expected, np.float32)
        if values is None or not names:
            missing = f"the model has exogenous inputs ({names}): give exogenous= of shape {expected}"
            message = missing if names else "the model has no exogenous inputs; leave exogenous= out"
            raise PlanningError(message)
        return self._rows(values, f"exogenous inputs ({names})", expected)

    def until(self, state: Values, exogenous: Values | None, steps: int) -> Situation:
        """Return the frames up to the current one.

        Args:
            state: current state, (d_obs,).
            exogenous: exogenous inputs during the steps ahead, (T, d_exo); None if the model has none.
            steps: number of steps ahead, T.

        Raises:
            PlanningError: too few frames were seen, or one of them has another shape.
        """
        if self.missing:
            history = self._features.history
            message = (
                f"the model predicts from {history} frames, and {self.missing} before this one are missing: call "
                f"observe(state, action) for the steps before, or give command() {history} states and the "
                f"{history - 1} actions between them"
            )
            raise PlanningError(message)
        now = self.states(state, ())
        states = np.stack([*(each.state for each in self._frames), now])
        actions = np.stack([each.action for each in self._frames]) if self._frames else None
        ahead = self.exogenous(exogenous, (steps,))
        replayed = np.concatenate([*(each.exogenous[None] for each in self._frames), ahead])
        return Situation(states, actions, replayed)

    def _rows(self, values: Values | int, what: str, expected: tuple[int, ...]) -> Float32[np.ndarray, " ..."]:
        found = finite(_as_tensor(values), what).numpy()
        if found.shape != expected:
            message = f"{what} should have shape {expected}, but shape {found.shape} was given"
            raise PlanningError(message)
        return found.copy()


def _as_tensor(values: Values | int) -> Tensor:
    return as_tensor(np.asarray(values) if isinstance(values, int) else values)
