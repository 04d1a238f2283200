"""What the states of an environment look like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from addressed_dynamics.reporting.common.animation.brush import Brush, Point

State = Float[np.ndarray, " dimension"]
FORE, BACK, SOFT = "#5a5a5a", "#c8c8c8", "#efefef"
"""What stands out without a colour of its own, what stands back, and what fills."""


@dataclass(frozen=True)
class Scene:
    """How to draw the states of one environment."""

    title: str
    """What one sees, for instance `a car in a valley`."""
    dimensions: tuple[str, ...]
    """Names of the dimensions of an observation that it needs, in the order in which its functions take them."""
    actions: tuple[str, ...]
    """Names of the actions; the middle one does nothing."""
    height: int
    """Height of the picture of one state, in pixels."""
    origin: Point
    """Where the scene's origin is in that picture, in pixels from the left and from the top."""
    scale: float
    """Pixels to one unit of the scene."""
    draw_ground: Callable[[Brush], None]
    """Draws what never moves."""
    draw_body: Callable[[Brush, State, str], None]
    """Draws what has a state, in a colour."""
    draw_action: Callable[[Brush, State, int], None]
    """Draws an action, -1 or 1, at the body that it acts on."""
    error: Callable[[State, State], str]
    """Says how far a predicted state is from the true one."""
    error_title: str
    """What it says, as a part of a sentence."""
