"""How much of the state space the data has seen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

CELLS = 50
"""Number of equal cells along a dimension."""


@dataclass(frozen=True)
class Occupancy:
    """Which cells between the bounds of the state space hold an observation."""

    per_dimension: Bool[np.ndarray, "dimension cell"]
    """Cells along each dimension by itself."""
    grid: Bool[np.ndarray, "cell cell"] | None
    """Cells of the plane if the observation has two dimensions, else None: more have too many cells to fill."""

    @staticmethod
    def of(
        observation: Float[np.ndarray, "step dimension"],
        low: Float[np.ndarray, " dimension"],
        high: Float[np.ndarray, " dimension"],
    ) -> Occupancy:
        """Mark the cells between `low` and `high` that `observation` lies in; beyond a bound counts as at it."""
        cells = _cells(observation, low, high)
        dimensions = observation.shape[1]
        per_dimension = np.zeros((dimensions, CELLS), dtype=bool)
        per_dimension[np.arange(dimensions), cells] = True
        if dimensions != 2:
            return Occupancy(per_dimension, None)
        grid = np.zeros((CELLS, CELLS), dtype=bool)
        grid[cells[:, 0], cells[:, 1]] = True
        return Occupancy(per_dimension, grid)

    def merge(self, other: Occupancy) -> Occupancy:
        """Mark what either of the two marks."""
        grid = None if self.grid is None or other.grid is None else self.grid | other.grid
        return Occupancy(self.per_dimension | other.per_dimension, grid)


def _cells(
    observation: Float[np.ndarray, "step dimension"],
    low: Float[np.ndarray, " dimension"],
    high: Float[np.ndarray, " dimension"],
) -> Int[np.ndarray, "step dimension"]:
    width = np.where(high > low, high - low, 1.0)
    cells: Int[np.ndarray, "step dimension"] = ((observation - low) / width * CELLS).clip(0, CELLS - 1).astype(np.int64)
    return cells
