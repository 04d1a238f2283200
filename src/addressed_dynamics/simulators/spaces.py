"""The spaces of a learned environment, as Gymnasium has them, and what lies in them."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.spaces import Box, Discrete
from jaxtyping import Float32

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.simulators.arrays import as_tensor, finite
from addressed_dynamics.simulators.starts import Starts


def observation_box(spaces: SpaceSpec) -> Box:
    """Return the space of states."""
    return _box(spaces.observation)


def space_of_actions(spaces: SpaceSpec, starts: Starts | None) -> Box | Discrete:
    """Return the space of actions; where components have no bounds, what was recorded bounds them."""
    kind = spaces.action
    if isinstance(kind, DiscreteAction):
        return Discrete(kind.count)
    space = _box(kind.dimensions)
    if starts is None:
        return space
    lowest, highest = starts.action_range
    low, high = np.isfinite(space.low), np.isfinite(space.high)
    return Box(np.where(low, space.low, lowest), np.where(high, space.high, highest), dtype=np.float32)


def checked_actions(spaces: SpaceSpec, space: Box | Discrete, actions: Any, number: int) -> np.ndarray:
    """Return actions of so many copies as a model takes them.

    Raises:
        ModelError: they are of another number or type, or outside the space.
    """
    given, kind = as_tensor(actions), spaces.action
    if isinstance(kind, DiscreteAction):
        chosen = given.numpy()
        if chosen.shape != (number,) or chosen.dtype.kind not in "iu":
            message = f"actions should be {number} integers, but are {chosen.dtype} of shape {chosen.shape}"
            raise ModelError(message)
        outside = (chosen < 0) | (chosen >= kind.count)
        if outside.any():
            names = ", ".join(kind.names)
            message = f"actions should lie in 0..{kind.count - 1} ({names}), but one is {chosen[outside][0]}"
            raise ModelError(message)
        return chosen.astype(np.int64)
    assert isinstance(space, Box)
    shape = (number, len(kind.dimensions))
    if given.shape != shape:
        message = f"actions should have shape {shape}, but have {tuple(given.shape)}"
        raise ModelError(message)
    numbers = finite(given, "actions").numpy()
    check_bounds(numbers, space, kind.dimensions, "actions")
    return numbers


def check_bounds(
    values: Float32[np.ndarray, "*batch dimension"], space: Box, dimensions: tuple[Dimension, ...], what: str
) -> None:
    """Check that values lie in a space.

    Raises:
        ModelError: one does not.
    """
    outside = (values < space.low) | (values > space.high)
    if outside.any():
        place = tuple(np.argwhere(outside)[0].tolist())
        bad, low, high = dimensions[place[-1]], space.low[place[-1]], space.high[place[-1]]
        unit = f" {bad.unit}" if bad.unit else ""
        message = f"{what}: '{bad.name}' should lie in {low:g}..{high:g}{unit}, but one is {values[place]:g}"
        raise ModelError(message)


def _box(dimensions: tuple[Dimension, ...]) -> Box:
    low, high = np.array([(each.low, each.high) for each in dimensions], np.float32).reshape(-1, 2).T
    return Box(low, high, dtype=np.float32)


def checked_hold(hold: int) -> int:
    """Return for how many steps an action is held, if it is for one at least.

    Raises:
        ModelError: it is not.
    """
    if hold < 1:
        message = f"hold should be at least 1, but is {hold}"
        raise ModelError(message)
    return hold
