"""What float32, in which transitions are kept, cannot tell apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

ROUNDING = 16.0
"""Neighbouring float64 values so many units in the last place apart differ by rounding, not by a step."""


@dataclass(frozen=True)
class Swallowed:
    """How many steps of each dimension change it, and how many of these float32 turns into none."""

    changed: Int64[np.ndarray, " dimension"]
    """Steps in which the values differ by more than rounding."""
    lost: Int64[np.ndarray, " dimension"]
    """Those of them in which the values are equal in float32."""

    def merge(self, other: Swallowed) -> Swallowed:
        """Add the steps of another recording with the same dimensions."""
        return Swallowed(self.changed + other.changed, self.lost + other.lost)

    @property
    def mostly(self) -> Bool[np.ndarray, " dimension"]:
        """Dimensions of which most changes are lost."""
        return np.asarray(2 * self.lost > self.changed)


def swallowed(values: Float64[np.ndarray, "sample dimension"], follows: Bool[np.ndarray, " sample"]) -> Swallowed:
    """Count the steps that float32 swallows.

    Args:
        values: samples in order; what is not finite is no step.
        follows: the sample is one step after the one before it.
    """
    inside = follows[1:]
    before, after = values[:-1][inside], values[1:][inside]
    with np.errstate(over="ignore", invalid="ignore"):
        rounding = ROUNDING * np.spacing(np.maximum(np.abs(before), np.abs(after)))
        changed = np.abs(after - before) > rounding
        kept_before, kept_after = before.astype(np.float32), after.astype(np.float32)
        lost = changed & np.isfinite(kept_after) & (kept_before == kept_after)
    return Swallowed(changed.sum(axis=0), lost.sum(axis=0))
