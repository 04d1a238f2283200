"""Drawing in the coordinates of a scene, larger than it is shown, so that edges come out smooth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import ImageDraw, ImageFont

OVERSAMPLING = 2
"""Pixels that are drawn, along each side of a pixel that is shown."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Brush:
    """Draws on a part of a canvas. Places are those of the scene, with y upwards; widths and sizes are shown pixels."""

    canvas: ImageDraw.ImageDraw
    """The canvas, `OVERSAMPLING` times as large as what is shown."""
    origin: Point
    """Where the scene's origin is, in shown pixels from the left and from the top."""
    scale: float = 1.0
    """Shown pixels to one unit of the scene."""

    def line(self, points: Sequence[Point], colour: str, width: float) -> None:
        """Draw a line through `points` with round ends and corners."""
        places = self._places(points)
        self.canvas.line(places, fill=colour, width=round(width * OVERSAMPLING), joint="curve")
        for place in (places[0], places[-1]):
            self._disc(place, colour, width / 2)

    def polygon(self, points: Sequence[Point], colour: str) -> None:
        """Fill the polygon with these corners."""
        self.canvas.polygon(self._places(points), fill=colour)

    def disc(self, middle: Point, colour: str, radius: float) -> None:
        """Fill a disc."""
        (place,) = self._places([middle])
        self._disc(place, colour, radius)

    def arrow(self, points: Sequence[Point], colour: str, width: float) -> None:
        """Draw a line through `points` with a head at the end of the last stretch."""
        self.line(points, colour, width)
        before, tip = np.array(points[-2]), np.array(points[-1])
        along = (tip - before) / np.linalg.norm(tip - before)
        across = np.array([-along[1], along[0]])
        length = 3.2 * width / self.scale
        corners = [tip + length * along, tip + 0.75 * length * across, tip - 0.75 * length * across]
        self.polygon([(float(x), float(y)) for x, y in corners], colour)

    def text(
        self, place: Point, words: str, colour: str, size: float, *, bold: bool = False, anchor: str = "ls"
    ) -> None:
        """Write `words`; `anchor` says which point of them is at `place`, as in Pillow."""
        (where,) = self._places([place])
        self.canvas.text(where, words, fill=colour, font=_font(round(size * OVERSAMPLING), bold), anchor=anchor)

    def _places(self, points: Sequence[Point]) -> list[Point]:
        left, top = self.origin
        return [((left + x * self.scale) * OVERSAMPLING, (top - y * self.scale) * OVERSAMPLING) for x, y in points]

    def _disc(self, place: Point, colour: str, radius: float) -> None:
        x, y, reach = *place, radius * OVERSAMPLING
        self.canvas.ellipse((x - reach, y - reach, x + reach, y + reach), fill=colour)


@cache
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    # Matplotlib brings the font of all other figures along; Pillow's other layout engine may not be installed.
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    path = Path(mpl.get_data_path()) / "fonts" / "ttf" / name
    return ImageFont.truetype(path, size, layout_engine=ImageFont.Layout.BASIC)
