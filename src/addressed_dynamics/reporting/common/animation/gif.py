"""Pictures of few colours, and the GIF that they make."""

from __future__ import annotations

import io
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from jaxtyping import Float64
from PIL import Image, ImageColor

from addressed_dynamics.reporting.common.animation.brush import OVERSAMPLING
from addressed_dynamics.reporting.common.blocks import Panel

_SHADES = OVERSAMPLING**2
_LEVELS = 32


class Palette:
    """White, and each of some colours in shades towards white: what smooth edges on white consist of."""

    def __init__(self, colours: Sequence[str], flat: Sequence[str] = ()) -> None:
        """Take colours, written as `#rrggbb`, and others that get no shades: nobody sees the edges of a light grey."""
        share = np.arange(1, _SHADES + 1)[:, None, None] / _SHADES
        shades = 255 + share * (_rgb(colours) - 255)
        self._colours = np.concatenate([[[255.0] * 3], shades.reshape(-1, 3), _rgb(flat)]).round().astype(np.uint8)
        # The nearest colour for each cell of a coarse grid over all colours.
        levels = np.linspace(0, 255, _LEVELS)  # white must stay white
        cells = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(-1, 3)
        colour = self._colours.astype(np.float64)
        # |cell - colour|² without |cell|², which all colours share
        distances = (colour**2).sum(axis=1) - 2 * cells @ colour.T
        self._nearest = distances.argmin(axis=1).astype(np.uint8)

    def reduced(self, picture: Image.Image) -> Image.Image:
        """Return an oversampled picture at the size at which it is shown, in the nearest of these colours."""
        level = (np.asarray(picture.reduce(OVERSAMPLING)) // (256 // _LEVELS)).astype(np.uint16)
        cell = (level[..., 0] * _LEVELS + level[..., 1]) * _LEVELS + level[..., 2]
        indexed = Image.fromarray(self._nearest.take(cell), mode="P")
        indexed.putpalette(self._colours.tobytes())
        return indexed


def _rgb(colours: Sequence[str]) -> Float64[np.ndarray, "colour 3"]:
    return np.array([ImageColor.getrgb(colour) for colour in colours], dtype=np.float64).reshape(-1, 3)


def gif_panel(name: str, alternative: str, frames: Sequence[Image.Image], frame_seconds: float) -> Panel:
    """Return a GIF that repeats, and its last picture for readers who want no motion.

    Args:
        name: name of the file, without suffix.
        alternative: what a reader who cannot see it should know.
        frames: its pictures, of one palette.
        frame_seconds: time from one to the next, in seconds.
    """
    # A GIF counts hundredths of a second: rounding each picture's end, not its duration, keeps the clock right.
    ends = [10 * round(100 * frame_seconds * index) for index in range(len(frames) + 1)]
    durations = [end - start for start, end in pairwise(ends)]
    buffer, still = io.BytesIO(), io.BytesIO()
    frames[0].save(buffer, "GIF", save_all=True, append_images=frames[1:], duration=durations, loop=0)
    frames[-1].save(still, "PNG", optimize=True)
    return Panel(name, alternative, buffer.getvalue(), *frames[0].size, format="gif", still=still.getvalue())
