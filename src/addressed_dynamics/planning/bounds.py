"""Between which values the components of a continuous action lie."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import PlanningError
from addressed_dynamics.episodes.transitions import ContinuousAction

NO_BOUND = 1e30
"""A bound as large as this is merely a number that an environment wrote down."""
Bounds: TypeAlias = "tuple[float | Sequence[float], float | Sequence[float]]"
"""Lowest and highest action, one number for all components or one for each, in their units."""


class Box(NamedTuple):
    """Where continuous actions lie."""

    low: Float64[np.ndarray, " action"]
    high: Float64[np.ndarray, " action"]


def action_box(action: ContinuousAction, bounds: Bounds | None) -> Box:
    """Return where actions lie: by `bounds` if there are some, else by what the model says.

    Args:
        action: the model's actions.
        bounds: the user's; None for the model's.

    Raises:
        PlanningError: the model has none and the user gave none, or they are no bounds of these actions.
    """
    names = [each.name for each in action.dimensions]
    if bounds is None:
        low = np.array([each.low for each in action.dimensions], np.float64)
        high = np.array([each.high for each in action.dimensions], np.float64)
        unbounded = [each.name for each in action.dimensions if max(abs(each.low), abs(each.high)) >= NO_BOUND]
        if unbounded:
            message = (
                f"the model does not say between which values actions lie ({', '.join(unbounded)}); "
                f"give bounds=(low, high), each a number or one for each of {', '.join(names)}"
            )
            raise PlanningError(message)
    else:
        low, high = _bounds_given(bounds, names)
    if not (low < high).all():
        worst = int(np.argmin(high - low))
        message = (
            f"the action '{names[worst]}' should have a low bound below its high one: {low[worst]:g}, {high[worst]:g}"
        )
        raise PlanningError(message)
    return Box(low, high)


def _bounds_given(
    bounds: Bounds, names: Sequence[str]
) -> tuple[Float64[np.ndarray, " action"], Float64[np.ndarray, " action"]]:
    try:
        low, high = (np.broadcast_to(np.asarray(each, np.float64), len(names)) for each in bounds)
    except (TypeError, ValueError) as error:
        message = f"bounds should be (low, high), each a number or one for each of {', '.join(names)} ({error})"
        raise PlanningError(message) from error
    if not np.isfinite([low, high]).all():
        message = f"bounds should be finite, but are {low.tolist()} and {high.tolist()}"
        raise PlanningError(message)
    return low, high
