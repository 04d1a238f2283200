"""Acrobot: two links that hang from a pivot, the height of the goal, and the torque between the links."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float

from addressed_dynamics.reporting.common.animation.brush import Brush, Point
from addressed_dynamics.reporting.common.animation.scenes import BACK, Scene, State
from addressed_dynamics.reporting.common.figures.style import ACTION, REACHED

GOAL_HEIGHT = 1.0
"""How far above the pivot the tip has to get, in m, as Gymnasium's environment has it."""
_REACH = 2.1


def _draw_ground(brush: Brush) -> None:
    for start in np.arange(-_REACH + 0.02, _REACH, 0.14):
        brush.line([(float(start), GOAL_HEIGHT), (float(start) + 0.07, GOAL_HEIGHT)], REACHED, 1.5)
    brush.line([(-0.25, 0.0), (0.25, 0.0)], BACK, 3)


def _draw_body(brush: Brush, state: State, colour: str) -> None:
    joint, tip = _places(state)
    brush.line([(0.0, 0.0), joint], colour, 10)
    brush.line([joint, tip], colour, 7)
    for place, radius in (((0.0, 0.0), 3.0), (joint, 2.5)):
        brush.disc(place, "#ffffff", radius)


def _draw_action(brush: Brush, state: State, direction: int) -> None:
    (x, y), _ = _places(state)
    # From the middle of the angle that the outer link makes with the inner one, on the side where neither is.
    angle_1, angle_2 = _angles(state)
    middle = angle_1 + (angle_2 + math.pi) / 2 + (math.pi if angle_2 > 0 else 0.0)
    arc = middle + direction * np.linspace(-0.75, 0.55, 14)
    brush.arrow([(x + 0.25 * math.sin(turn), y - 0.25 * math.cos(turn)) for turn in arc.tolist()], ACTION, 3)


def _angles(state: State) -> Float[np.ndarray, 2]:
    """Return both angles in rad; the first from hanging down, the second from the first link."""
    angles: Float[np.ndarray, 2] = np.arctan2(state[1::2], state[::2])
    return angles


def _places(state: State) -> tuple[Point, Point]:
    """Return where the joint between the links and the tip are, in m from the pivot."""
    first, second = np.cumsum(_angles(state)).tolist()
    joint = (math.sin(first), -math.cos(first))
    return joint, (joint[0] + math.sin(second), joint[1] - math.cos(second))


def _error(true: State, predicted: State) -> str:
    difference = _angles(predicted) - _angles(true)
    first, second = np.abs(np.remainder(difference + math.pi, 2 * math.pi) - math.pi)
    return f"off by {first:.3f} rad and {second:.3f} rad"


ACROBOT = Scene(
    title="two links that hang from a pivot",
    dimensions=("cos_angle_1", "sin_angle_1", "cos_angle_2", "sin_angle_2"),
    actions=("torque_negative", "no_torque", "torque_positive"),
    height=312,
    origin=(198, 156),
    scale=72,
    draw_ground=_draw_ground,
    draw_body=_draw_body,
    draw_action=_draw_action,
    error=_error,
    error_title="by how much both of its angles are off",
)
