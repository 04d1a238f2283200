"""Acting in several environment copies side by side, each until it has made its share of a segment's steps."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import gymnasium
import numpy as np

from addressed_dynamics.recording.behaviours import Policy

Progress = Callable[[int], object]
"""Called with the number of simulated steps made since its last call."""


class FrameSkip(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Holds each action for several simulated steps, one decision, and makes exactly as many steps as it is given.

    A decision is over early if the episode ends in it, or if no step is left. Gymnasium's `RepeatAction` does not
    count, and with episodes that end inside a decision, copies with equally many decisions have unequally many steps.

    Args:
        env: the environment; a recorder, if every simulated step is to be recorded.
        frame_skip: simulated steps in a decision.
        steps: simulated steps to make.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], frame_skip: int, steps: int) -> None:
        super().__init__(env)
        self._frame_skip = frame_skip
        self.steps_left = steps
        """Simulated steps that are still to be made."""
        self.observation: Any = None
        """What the next decision is made on."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environment."""
        self.observation, info = self.env.reset(seed=seed, options=options)
        return self.observation, info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make one decision; there must be a step left.

        Returns:
            What the last of its steps returned, with the sum of the rewards of all of them.
        """
        rewards = 0.0
        for _ in range(min(self._frame_skip, self.steps_left)):
            self.observation, reward, terminated, truncated, info = self.env.step(action)
            self.steps_left -= 1
            rewards += float(reward)
            if terminated or truncated:
                break
        return self.observation, rewards, terminated, truncated, info


def act(
    copies: Sequence[FrameSkip], policy: Policy, progress: Progress, began: Callable[[int], object] = lambda _: None
) -> None:
    """Go on in all `copies`, which have been reset, until none has a step left.

    Args:
        copies: copies of one environment.
        policy: asked for the actions of all copies at every decision, also of those that have no step left.
        progress: see `Progress`.
        began: called with the number of a copy when another episode begins in it.
    """
    while any(copy.steps_left for copy in copies):
        actions = policy(np.stack([copy.observation for copy in copies]))
        before = sum(copy.steps_left for copy in copies)
        for number, (copy, action) in enumerate(zip(copies, actions, strict=True)):
            if copy.steps_left:
                _, _, terminated, truncated, _ = copy.step(action)
                if terminated or truncated:
                    copy.reset()
                    began(number)
        progress(before - sum(copy.steps_left for copy in copies))
