"""A rollout as a GIF: truth to the left, the model to the right, under the same actions."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from PIL import Image, ImageDraw

from addressed_dynamics.reporting.common.animation.brush import OVERSAMPLING, Brush
from addressed_dynamics.reporting.common.animation.gif import Palette, gif_panel
from addressed_dynamics.reporting.common.animation.scenes import BACK, FORE, SOFT, Scene
from addressed_dynamics.reporting.common.blocks import Panel
from addressed_dynamics.reporting.common.figures.style import ACTION, INK, OWN, REACHED

SECONDS = 10.0
"""Longest simulated time that is shown; it passes as fast as it did."""
FRAME_SECONDS = 0.08
"""Time between two pictures, about: a whole number of steps comes nearest to it."""
SIDE, GAP = 396, 28
"""Width of the picture of one state, and what lies between the two, in pixels."""
HEAD, FOOT = 36, 8
"""Height of what is written above the pictures, and of what stays free below, in pixels."""

NAME_SIZE, NOTE_SIZE = 20, 17
"""Sizes of what is written, in pixels: a telephone shows a film at less than half of them."""
BASELINE = -22
"""Where the line above the pictures stands, in pixels."""

_TRUTH, _MODEL = FORE, OWN
_PALETTE = Palette((INK, FORE, BACK, SOFT, OWN, ACTION, REACHED))


def film(
    name: str,
    title: str,
    scene: Scene,
    true: Float[np.ndarray, "time dimension"],
    predicted: Float[np.ndarray, "time dimension"],
    directions: Int[np.ndarray, " step"] | None,
    step_seconds: float,
) -> Panel:
    """Draw a rollout.

    Args:
        name: name of the file, without suffix.
        title: which rollout it is; may be empty.
        scene: how its states look.
        true: states as they were, the scene's dimensions only.
        predicted: the same as the model has them.
        directions: -1, 0 or 1 for the action in each state but the last; None if they are not known.
        step_seconds: simulated time of a step, in seconds.

    Returns:
        A GIF that repeats, and its last picture for readers who want no motion.
    """
    stride = max(1, round(FRAME_SECONDS / step_seconds))
    steps = range(0, min(len(true), round(SECONDS / step_seconds) + 1), stride)
    ground = _ground(scene, title)
    frames = [
        _frame(
            scene,
            ground,
            true[step],
            predicted[step],
            0 if directions is None or step >= len(directions) else int(directions[step]),
            step * step_seconds,
        )
        for step in steps
    ]
    alternative = f"Animation: {scene.title}{', ' * bool(title)}{title}; left as it was, right as the model has it"
    return gif_panel(name, alternative, frames, stride * step_seconds)


def _ground(scene: Scene, title: str) -> Image.Image:
    """Return what is the same in all pictures."""
    width, height = 2 * SIDE + GAP, HEAD + scene.height + FOOT
    ground = Image.new("RGB", (OVERSAMPLING * width, OVERSAMPLING * height), "#ffffff")
    canvas = ImageDraw.Draw(ground)
    head = Brush(canvas, (0, 0))
    for left, words, colour in ((0, "truth", _TRUTH), (SIDE + GAP, "model", _MODEL)):
        head.text((left + 2, BASELINE), words, colour, NAME_SIZE, bold=True)
        scene.draw_ground(_side(scene, canvas, left))
    head.text((78, BASELINE), title, INK, NOTE_SIZE)
    return ground


def _frame(
    scene: Scene,
    ground: Image.Image,
    true: Float[np.ndarray, " dimension"],
    predicted: Float[np.ndarray, " dimension"],
    direction: int,
    seconds: float,
) -> Image.Image:
    picture = ground.copy()
    canvas = ImageDraw.Draw(picture)
    left, right = _side(scene, canvas, 0), _side(scene, canvas, SIDE + GAP)
    scene.draw_body(left, true, _TRUTH)
    scene.draw_body(right, true, BACK)
    scene.draw_body(right, predicted, _MODEL)
    if direction:
        scene.draw_action(left, true, direction)
        scene.draw_action(right, predicted, direction)
    head = Brush(canvas, (0, 0))
    head.text((SIDE - 2, BASELINE), f"{seconds:.2f} s", INK, NOTE_SIZE, anchor="rs")
    head.text((2 * SIDE + GAP - 2, BASELINE), scene.error(true, predicted), INK, NOTE_SIZE, anchor="rs")
    return _PALETTE.reduced(picture)


def _side(scene: Scene, canvas: ImageDraw.ImageDraw, left: int) -> Brush:
    x, y = scene.origin
    return Brush(canvas, (left + x, HEAD + y), scene.scale)
