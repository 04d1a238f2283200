"""People of 31 joints who move under commands, each seen by a camera that goes along with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64
from PIL import Image, ImageDraw

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.reporting.common.animation.brush import OVERSAMPLING, Brush
from addressed_dynamics.reporting.common.animation.camera import Camera
from addressed_dynamics.reporting.common.animation.film import BASELINE, GAP, HEAD, NAME_SIZE, NOTE_SIZE
from addressed_dynamics.reporting.common.animation.gif import Palette, gif_panel
from addressed_dynamics.reporting.common.blocks import Panel
from addressed_dynamics.reporting.common.figures.style import INK
from addressed_dynamics.reporting.motion.actors import ASKED, BODIES, TOUCHED, Actor, check_actors, facing
from addressed_dynamics.reporting.motion.animation.figure import SHADES, draw_body, draw_ground

SECONDS = 10.0
"""Longest time that is shown; it passes as fast as it did."""
STRIDE = 5
"""Frames from one picture to the next."""
SIDE, HEIGHT, FOOT = 340, 264, 30
"""Size of the picture of one person, and height of what is written below, in pixels."""

_PALETTE = Palette((INK, *BODIES, ASKED, TOUCHED), flat=SHADES)
_ELEVATION, _DISTANCE, _SCALE = np.radians(16.0), 900.0, 1.22
_SIDEWAYS = np.radians(58.0)  # from where a person faces to where the camera is
_MIDDLE = 69.0  # height in cm of what is in the middle of a picture
_SMOOTHING = 0.3 * FRAME_RATE  # frames


def skeleton_film(
    name: str, title: str, actors: Sequence[Actor], commands: Float[np.ndarray, "time 2"] | None = None
) -> Panel:
    """Draw one person, or two side by side who are given the same commands.

    Args:
        name: name of the file, without suffix.
        title: what they are told; may be empty.
        actors: the people; all over the same time.
        commands: velocity that is asked for in the world, x and z in cm/frame; None to show none.

    Returns:
        A GIF that repeats, of the first `SECONDS`, and its last picture for readers who want no motion.

    Raises:
        ReportError: there are no actors or more than two, they differ in length or share a title, or a position is
            not finite.
    """
    check_actors(actors, commands)
    shown = min(len(actors[0].positions), round(SECONDS * FRAME_RATE))
    paths = [_smooth(actor.positions[:shown, 0]) for actor in actors]
    azimuth = float(facing(actors[0].positions[0])) + _SIDEWAYS
    frames = []
    for index in range(0, shown, STRIDE):
        command = None if commands is None else commands[index]
        sides = []
        for actor, path, colour in zip(actors, paths, BODIES, strict=False):
            camera = Camera(path[index] * [1, 0, 1] + [0, _MIDDLE, 0], azimuth, _ELEVATION, _DISTANCE, _SCALE)
            sides.append(_side(camera, actor, index, command, colour))
        speeds = [_speed(path, index) for path in paths]
        frames.append(_PALETTE.reduced(_picture(title, actors, sides, speeds, command, index / FRAME_RATE)))
    told = f"Animation: {title or 'motion under commands'}; {' left, '.join(actor.title for actor in actors)}"
    return gif_panel(name, told + " right" * (len(actors) > 1), frames, STRIDE / FRAME_RATE)


def _side(camera: Camera, actor: Actor, index: int, command: Float[np.ndarray, 2] | None, colour: str) -> Image.Image:
    """Return the picture of one person, oversampled."""
    side = Image.new("RGB", (OVERSAMPLING * SIDE, OVERSAMPLING * HEIGHT), "#ffffff")
    brush = Brush(ImageDraw.Draw(side), (SIDE / 2, HEIGHT / 2))
    touching = actor.touching()[: index + 1]
    draw_ground(brush, camera, actor.positions[: index + 1], touching, command)
    draw_body(brush, camera, actor.positions[index].astype(np.float64), touching[-1], colour)
    return side


def _picture(
    title: str,
    actors: Sequence[Actor],
    sides: Sequence[Image.Image],
    speeds: Sequence[float],
    command: Float[np.ndarray, 2] | None,
    seconds: float,
) -> Image.Image:
    """Return the pictures side by side with what is written around them, oversampled."""
    width = len(sides) * SIDE + (len(sides) - 1) * GAP
    picture = Image.new("RGB", (OVERSAMPLING * width, OVERSAMPLING * (HEAD + HEIGHT + FOOT)), "#ffffff")
    brush = Brush(ImageDraw.Draw(picture), (0, 0))
    for index, (actor, side, speed) in enumerate(zip(actors, sides, speeds, strict=True)):
        left = index * (SIDE + GAP)
        picture.paste(side, (OVERSAMPLING * left, OVERSAMPLING * HEAD))
        brush.text((left + 2, BASELINE), actor.title, BODIES[index], NAME_SIZE, bold=True)
        brush.text((left + SIDE - 2, BASELINE), f"{speed:.1f} m/s", INK, NOTE_SIZE, anchor="rs")
    below = -(HEAD + HEIGHT + FOOT - 9)
    brush.text((2, below), f"{seconds:.1f} s", INK, NOTE_SIZE)
    brush.text((78, below), title, INK, NOTE_SIZE)
    if command is not None:
        asked = float(np.hypot(*command)) * FRAME_RATE / 100
        words = f"asked to go at {asked:.1f} m/s" if asked > 0.05 else "asked to stand"
        brush.text((width - 2, below), words, ASKED, NOTE_SIZE, anchor="rs")
    return picture


def _smooth(path: Float[np.ndarray, "time 3"]) -> Float64[np.ndarray, "time 3"]:
    """Return the path of a camera that does not follow every step."""
    reach = round(3 * _SMOOTHING)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / _SMOOTHING) ** 2)
    # Beyond the ends it goes on as it went there: a camera that stops early would lose who runs.
    padded = np.pad(path.astype(np.float64), ((reach, reach), (0, 0)), mode="reflect", reflect_type="odd")
    return np.stack([np.convolve(column, weights / weights.sum(), mode="valid") for column in padded.T], axis=1)


def _speed(path: Float64[np.ndarray, "time 3"], index: int) -> float:
    """Return how fast one goes over the ground, in m/s."""
    before, after = max(0, index - 6), min(len(path) - 1, index + 6)
    if after == before:
        return 0.0
    way = path[after] - path[before]
    return float(np.hypot(way[0], way[2])) * FRAME_RATE / (100 * (after - before))
