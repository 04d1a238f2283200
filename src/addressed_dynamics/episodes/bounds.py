"""Which bounds of a dimension say something about the data; those of some environments are merely huge numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Float64

from addressed_dynamics.episodes.transitions import Dimension

WIDEST_BOUNDS = 1e6
"""Bounds that are more than so many times as far apart as the data bound nothing."""


def meant_bounds(
    dimensions: Sequence[Dimension], lowest: Float[np.ndarray, " dimension"], highest: Float[np.ndarray, " dimension"]
) -> tuple[Float64[np.ndarray, " dimension"], Float64[np.ndarray, " dimension"]]:
    """Return the lower and upper bounds that mean something, and infinity in place of the others.

    A pair of bounds means nothing if it is over a million times as far apart as the data. So does a bound without a
    counterpart, if the farther end of the data is so far from it. Of a column that is constant, its distance from 0
    stands for the range, and 1 if that is less.

    Args:
        dimensions: what the columns are.
        lowest: least value of each, in its unit.
        highest: greatest value of each, in its unit.
    """
    low, high = np.array([(dimension.low, dimension.high) for dimension in dimensions], np.float64).reshape(-1, 2).T
    least, most = lowest.astype(np.float64), highest.astype(np.float64)
    # A constant column has no range to compare with; what is left is how far out it lies.
    reach = np.where(most > least, most - least, np.maximum(np.maximum(np.abs(least), np.abs(most)), 1.0))
    width = np.where(np.isfinite(high), high, most) - np.where(np.isfinite(low), low, least)
    meant = width <= WIDEST_BOUNDS * reach
    return np.where(meant, low, -np.inf), np.where(meant, high, np.inf)


def display_range(
    dimensions: Sequence[Dimension], lowest: Float[np.ndarray, " dimension"], highest: Float[np.ndarray, " dimension"]
) -> tuple[Float64[np.ndarray, " dimension"], Float64[np.ndarray, " dimension"]]:
    """Return from where to where a display of each dimension should reach: by its bounds, and else by its data.

    Args:
        dimensions: what the columns are.
        lowest: least value of each, in its unit.
        highest: greatest value of each, in its unit.
    """
    low, high = meant_bounds(dimensions, lowest, highest)
    return np.where(np.isfinite(low), low, lowest), np.where(np.isfinite(high), high, highest)
