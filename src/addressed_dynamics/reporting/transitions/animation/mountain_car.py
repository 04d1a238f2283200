"""MountainCar: a car between two hills, its flag, and the push."""

from __future__ import annotations

import math

import numpy as np

from addressed_dynamics.envs.mountain_car import HIGHEST_POSITION, LOWEST_POSITION
from addressed_dynamics.reporting.common.animation.brush import Brush, Point
from addressed_dynamics.reporting.common.animation.scenes import BACK, FORE, SOFT, Scene, State
from addressed_dynamics.reporting.common.figures.style import ACTION, REACHED

GOAL = 0.5
"""Position of the flag, as Gymnasium's environment has it."""
_MARGIN = 0.09
_CAR_LENGTH, _WHEEL = 0.13, 0.026


def _height(position: float) -> float:
    """Return the height of the track, as Gymnasium draws it."""
    return 0.45 * math.sin(3 * position) + 0.55


def _on_track(position: float, along: float, above: float) -> Point:
    """Return a place in the coordinates of a car at `position`: along its track, and perpendicular to it."""
    slope = math.atan(1.35 * math.cos(3 * position))
    x = position + along * math.cos(slope) - above * math.sin(slope)
    return x, _height(position) + along * math.sin(slope) + above * math.cos(slope)


def _draw_ground(brush: Brush) -> None:
    track = [
        (float(x), _height(float(x))) for x in np.linspace(LOWEST_POSITION - _MARGIN, HIGHEST_POSITION + _MARGIN, 120)
    ]
    brush.polygon([*track, (track[-1][0], 0.0), (track[0][0], 0.0)], SOFT)
    brush.line(track, BACK, 1.5)
    for wall, outwards in ((LOWEST_POSITION, -1), (HIGHEST_POSITION, 1)):
        # A car is a point to the environment: its middle stops at the wall.
        side = wall + outwards * _CAR_LENGTH / 2
        brush.line([(side, _height(side)), (side, _height(side) + 0.2)], BACK, 2)
    foot = _height(GOAL)
    brush.line([(GOAL, foot), (GOAL, foot + 0.24)], FORE, 1.5)
    brush.polygon([(GOAL, foot + 0.24), (GOAL - 0.1, foot + 0.205), (GOAL, foot + 0.17)], REACHED)


def _draw_body(brush: Brush, state: State, colour: str) -> None:
    position = _shown(state)
    half, low, high = _CAR_LENGTH / 2, _WHEEL, 0.075
    outline = [(-half, low), (half, low), (half, 0.052), (0.55 * half, high), (-0.55 * half, high), (-half, 0.052)]
    brush.polygon([_on_track(position, *corner) for corner in outline], colour)
    for axle in (-0.55 * half, 0.55 * half):
        brush.disc(_on_track(position, axle, _WHEEL), colour, 1.15 * _WHEEL * brush.scale)
        brush.disc(_on_track(position, axle, _WHEEL), "#ffffff", 0.5 * _WHEEL * brush.scale)


def _draw_action(brush: Brush, state: State, direction: int) -> None:
    position = _shown(state)
    start, end = (_on_track(position, direction * along, 0.125) for along in (-0.05, 0.035))
    brush.arrow([start, end], ACTION, 3)


def _shown(state: State) -> float:
    """Return the position, kept near the track where a model lost it."""
    return float(np.clip(state[0], LOWEST_POSITION - _MARGIN, HIGHEST_POSITION + _MARGIN))


def _error(true: State, predicted: State) -> str:
    position, velocity = np.abs(predicted - true)
    return f"off by {position:.4f} m and {velocity:.5f} m/step"


MOUNTAIN_CAR = Scene(
    title="a car between two hills",
    dimensions=("position", "velocity"),
    actions=("push_left", "no_push", "push_right"),
    height=256,
    origin=((_MARGIN - LOWEST_POSITION) * 200, 252),
    scale=200,
    draw_ground=_draw_ground,
    draw_body=_draw_body,
    draw_action=_draw_action,
    error=_error,
    error_title="by how much its position and its velocity are off",
)
