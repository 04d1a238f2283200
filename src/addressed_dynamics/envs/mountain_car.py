"""MountainCar without an end at the goal, and its dynamics as a function of arrays.

The paper's rollouts last 1,000 steps, so its car drives on past the goal and against the right wall (Section 4.1).
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.envs.classic_control.mountain_car import MountainCarEnv
from jaxtyping import Bool, Float, Float32, Float64, Int

from addressed_dynamics.base.errors import SpaceError

LOWEST_POSITION, HIGHEST_POSITION = -1.2, 0.6
HIGHEST_SPEED = 0.07
FORCE = 0.001
GRAVITY = 0.0025
GOAL = 0.5
"""Position from which a car that does not roll back has reached the goal, in m."""


def mountain_car_step(
    state: Float64[np.ndarray, "batch 2"],
    action: Int[np.ndarray, " batch"],
    force: float = FORCE,
    gravity: float = GRAVITY,
) -> Float64[np.ndarray, "batch 2"]:
    """Advance a batch of cars by one step of Gymnasium's `MountainCar-v0`, bit for bit as that environment does.

    The left wall stops the car. The right wall holds its position and leaves its velocity as it is; a car that stays
    there loses it to gravity. The goal plays no part.

    Args:
        state: position in metres and velocity in metres per step.
        action: 0 pushes to the left, 1 does not push, 2 pushes to the right.
        force: what a push adds to the velocity, in metres per step.
        gravity: what the steepest slope takes from it, in metres per step.

    Returns:
        The states after the step, in the same units.
    """
    position, velocity = state[:, 0], state[:, 1]
    # np.cos may differ from the environment's math.cos in the last bit, and 1,000 steps make such a bit visible.
    slope = np.fromiter(map(math.cos, (3 * position).tolist()), dtype=np.float64, count=len(position))
    velocity = velocity + ((action - 1) * force + slope * -gravity)
    velocity = np.clip(velocity, -HIGHEST_SPEED, HIGHEST_SPEED)
    position = np.clip(position + velocity, LOWEST_POSITION, HIGHEST_POSITION)
    velocity = np.where((position == LOWEST_POSITION) & (velocity < 0), 0.0, velocity)
    return np.stack([position, velocity], axis=1)


def mountain_car_reward(
    state: Float[np.ndarray, "batch 2"],  # noqa: ARG001 - the form of all functions of reward and end
    action: Int[np.ndarray, " batch"],  # noqa: ARG001 - as above
    next_state: Float[np.ndarray, "batch 2"],
) -> tuple[Float64[np.ndarray, " batch"], Bool[np.ndarray, " batch"]]:
    """Return reward and end of steps of Gymnasium's `MountainCar-v0`: -1 for each, until the goal is reached."""
    return np.full(len(next_state), -1.0), (next_state[:, 0] >= GOAL) & (next_state[:, 1] >= 0.0)


class MountainCarContinuing(MountainCarEnv):
    """Gymnasium's `MountainCar-v0` that never terminates; only a time limit ends an episode.

    Args:
        start_position: lowest and highest position of a first state, in metres, drawn uniformly.
        start_velocity: lowest and highest velocity of a first state, in metres per step, drawn uniformly.
        force: what a push adds to the velocity in a step, in metres per step: a stronger engine has more.
        gravity: what the steepest slope takes from the velocity in a step, in metres per step: steeper hills take more.
        render_mode: as in Gymnasium.

    Raises:
        SpaceError: a range is not two increasing numbers inside the track and the speed limit, or the force or gravity
            is negative or above the speed limit.
    """

    metadata = {  # noqa: RUF012 # Gymnasium declares it without ClassVar
        **MountainCarEnv.metadata,
        "addressed_dynamics": {
            "observation": (("position", "m"), ("velocity", "m/step")),
            "action": ("push_left", "no_push", "push_right"),
            "step_seconds": 1 / MountainCarEnv.metadata["render_fps"],
        },
    }

    def __init__(
        self,
        start_position: Sequence[float] = (-0.6, -0.4),
        start_velocity: Sequence[float] = (0.0, 0.0),
        force: float = FORCE,
        gravity: float = GRAVITY,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(render_mode=render_mode)
        for name, value in {"force": force, "gravity": gravity}.items():
            if not 0.0 <= value <= HIGHEST_SPEED:
                message = f"{name} should be a number in 0..{HIGHEST_SPEED}, but is {value}"
                raise SpaceError(message)
        self.force, self.gravity = force, gravity
        position = _checked_range("start_position", start_position, LOWEST_POSITION, HIGHEST_POSITION)
        velocity = _checked_range("start_velocity", start_velocity, -HIGHEST_SPEED, HIGHEST_SPEED)
        self._start_low, self._start_high = np.array([position, velocity]).T

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32[np.ndarray, "2"], dict[str, Any]]:
        """Draw a first state from the start ranges."""
        super().reset(seed=seed, options=options)
        self.state = self.np_random.uniform(self._start_low, self._start_high)
        return np.array(self.state, dtype=np.float32), {}

    def step(self, action: int) -> tuple[Float32[np.ndarray, "2"], float, bool, bool, dict[str, Any]]:
        """Advance by one step, as `MountainCar-v0` does, but go on at the goal."""
        observation, reward, _, truncated, info = super().step(action)
        return observation, reward, False, truncated, info


def _checked_range(name: str, value: Sequence[float], lowest: float, highest: float) -> tuple[float, float]:
    if len(value) != 2 or not lowest <= value[0] <= value[1] <= highest:
        message = f"{name} should be two increasing numbers in {lowest}..{highest}, but is {list(value)}"
        raise SpaceError(message)
    return float(value[0]), float(value[1])
