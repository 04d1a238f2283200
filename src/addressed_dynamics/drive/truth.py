"""The true side of a drive: an environment that takes the same actions as the model."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.drive.finding import made
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.recording.spaces import space_spec


class Happened(NamedTuple):
    """What really came of a step."""

    before: Float32[np.ndarray, " observation"]
    action: int | list[float]
    reward: float
    after: Float32[np.ndarray, " observation"]
    terminated: bool
    truncated: bool


class Truth:
    """An environment with the last frames that it showed.

    Raises:
        RecordingError: the environment cannot be made.
    """

    def __init__(self, params: EnvironmentParams, history: int) -> None:
        """Make it.

        Args:
            params: which environment.
            history: number of frames that a model beside it is given.
        """
        self._environment = made(params)
        self.spaces: SpaceSpec = space_spec(self._environment)
        self._history = history

    def reset(self, seed: int, neutral: np.ndarray, tell: Callable[[Happened], None]) -> None:
        """Start anew, and stay idle until there are as many frames as a model is given.

        Args:
            seed: of the first state.
            neutral: the action meanwhile.
            tell: is told of the steps.
        """
        observation, _ = self._environment.reset(seed=seed)
        self.frames = _flat(observation)[None]
        self.actions = neutral[None][:0]
        while len(self.frames) < self._history:
            tell(self.step(neutral))

    @property
    def state(self) -> Float32[np.ndarray, " observation"]:
        """The state it is in."""
        state: Float32[np.ndarray, " observation"] = self.frames[-1]
        return state

    def step(self, action: np.ndarray) -> Happened:
        """Take an action."""
        before = self.state
        discrete = isinstance(self.spaces.action, DiscreteAction)
        taken = int(action) if discrete else action.copy()
        observation, reward, terminated, truncated, _ = self._environment.step(taken)
        after = _flat(observation)
        self.frames = np.concatenate([self.frames, after[None]])[-self._history :]
        actions = np.concatenate([self.actions, action[None]])
        self.actions = actions[max(0, len(actions) + 1 - self._history) :]
        given = int(action) if discrete else [float(each) for each in action]
        return Happened(before, given, float(reward), after, bool(terminated), bool(truncated))

    def close(self) -> None:
        """Let the environment go."""
        self._environment.close()


def _flat(observation: object) -> Float32[np.ndarray, " observation"]:
    return np.array(observation, dtype=np.float32).reshape(-1)
