"""A camera that looks at a place in space."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Float64

from addressed_dynamics.reporting.common.animation.brush import Point


@dataclass(frozen=True)
class Camera:
    """A camera; the y axis points up."""

    target: Float64[np.ndarray, 3]
    """What it looks at, in cm: the middle of the picture."""
    azimuth: float
    """From where it looks, around the target from z towards x, in rad."""
    elevation: float
    """From how high it looks: 0 is level, in rad."""
    distance: float
    """How far from the target it is, in cm."""
    scale: float
    """Shown pixels to a cm at the target."""

    @cached_property
    def _axes(self) -> Float64[np.ndarray, "3 3"]:
        """Its directions to the right, up, and towards itself, in the world."""
        level = np.array([np.sin(self.azimuth), 0.0, np.cos(self.azimuth)])
        backwards = np.cos(self.elevation) * level + np.array([0.0, np.sin(self.elevation), 0.0])
        right = np.array([np.cos(self.azimuth), 0.0, -np.sin(self.azimuth)])
        return np.stack([right, np.cross(backwards, right), backwards])

    def nearness(self, points: Float[np.ndarray, "*any 3"]) -> Float64[np.ndarray, "*any"]:
        """Return how much nearer to the camera than its target points are, in cm."""
        nearness: Float64[np.ndarray, "*any"] = (points - self.target) @ self._axes[2]
        return nearness

    def seen(self, points: Float[np.ndarray, "point 3"]) -> list[Point]:
        """Return where points are in the picture, in shown pixels from its middle, y upwards."""
        away = np.maximum(self.distance - self.nearness(points), 0.1 * self.distance)
        places = (points - self.target) @ self._axes[:2].T * (self.scale * self.distance / away)[:, None]
        # Far outside is as good as anywhere: what draws cannot count that far.
        return [(x, y) for x, y in np.clip(places, -1e4, 1e4).tolist()]
