"""Starts of a learned environment that a user gives, in the options of `reset`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float32

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.simulators.arrays import as_tensor, finite
from addressed_dynamics.simulators.spaces import check_bounds, checked_actions

if TYPE_CHECKING:
    from addressed_dynamics.simulators.worlds import World

OPTIONS = ("state", "actions", "exogenous")


@dataclass(frozen=True)
class Given:
    """Starts that a user gave, one for each copy."""

    observation: Float32[np.ndarray, "copy frame observation"]
    action: np.ndarray
    """Actions in all frames but the last, (copy, frame - 1, ...)."""
    exogenous: Float32[np.ndarray, "copy row exogenous"] | None
    """Exogenous inputs from the first frame on; None if a function says them, or if there are none."""


def given_starts(world: World, options: Mapping[str, Any], number: int) -> Given | None:
    """Return the starts that options of `reset` give; None if they give none.

    Args:
        world: what is reset.
        options: `state`, (d,) or, with a history of H frames, (H, d), oldest first; with a history `actions`, those in
            all frames but the last; `exogenous`, from the first frame on, if they are replayed. Of every copy, with an
            axis more in front, or the same for all.
        number: number of copies.

    Raises:
        ModelError: an option is unknown, missing, of another shape, or outside the space.
    """
    if unknown := [str(key) for key in options if key not in OPTIONS]:
        message = f"reset knows no option '{unknown[0]}' (options: {', '.join(OPTIONS)})"
        raise ModelError(message)
    if "state" not in options:
        if options:
            message = f"option '{next(iter(options))}' belongs to a given start; give its 'state', too"
            raise ModelError(message)
        return None
    spaces, history = world.model.features.spaces, world.history
    width = len(spaces.observation)
    state = finite(as_tensor(options["state"]), "option 'state'").numpy()
    state = _for_all(state, "state", (width,) if history == 1 else (history, width), number)
    check_bounds(state, world.observation_space, spaces.observation, "option 'state'")
    frames = state.reshape(number, history, width)
    return Given(frames, _actions(world, options, number), _exogenous(world, options, number))


def _actions(world: World, options: Mapping[str, Any], number: int) -> np.ndarray:
    past, components = world.history - 1, world.action_space.shape or ()
    shape = (past, *components)
    if "actions" not in options and past:
        message = f"a start of {world.history} frames needs option 'actions', of shape {shape}"
        raise ModelError(message)
    action = _for_all(as_tensor(options.get("actions", np.empty(shape))).numpy(), "actions", shape, number)
    if not past:
        return action.astype(world.action_space.dtype)
    flat = action.reshape(number * past, *components)
    checked = checked_actions(world.model.features.spaces, world.action_space, flat, number * past)
    return checked.reshape(number, *shape)


def _exogenous(
    world: World, options: Mapping[str, Any], number: int
) -> Float32[np.ndarray, "copy row exogenous"] | None:
    width = len(world.model.features.spaces.exogenous)
    if not width or world.exogenous is not None:
        if "exogenous" in options:
            message = "option 'exogenous' is not asked for: nothing is replayed; leave it out"
            raise ModelError(message)
        return None
    rows = f"(rows, {width}), with at least {world.history} rows, the first beside the first frame"
    if "exogenous" not in options:
        message = f"a given start needs option 'exogenous', of shape {rows}; or give a function: exogenous="
        raise ModelError(message)
    values = finite(as_tensor(options["exogenous"]), "option 'exogenous'").numpy()
    if values.ndim not in (2, 3) or values.shape[-1] != width or values.shape[-2] < world.history:
        message = f"option 'exogenous' should have shape {rows}, but has {values.shape}"
        raise ModelError(message)
    return _for_all(values, "exogenous", values.shape[-2:], number)


def _for_all(values: np.ndarray, name: str, shape: tuple[int, ...], number: int) -> np.ndarray:
    """Return what an option gives to every copy, or to all the same."""
    if values.shape not in (shape, (number, *shape)):
        copies = f", or {(number, *shape)} for each copy" if number > 1 else ""
        message = f"option '{name}' should have shape {shape}{copies}, but has {values.shape}"
        raise ModelError(message)
    return np.array(np.broadcast_to(values, (number, *shape)))
