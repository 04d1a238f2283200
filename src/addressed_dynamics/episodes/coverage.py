"""How much of the state space the data has seen, and how often the same."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt64

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


def row_fingerprints(*columns: Shaped[np.ndarray, "row ..."]) -> UInt64[np.ndarray, " row"]:
    """Return 64 bits for each row that are equal for equal rows, and differ for different ones but for rare chance.

    Among a million rows that chance is 3e-8. 0 and -0 count as equal.
    """
    fingerprint = np.zeros(len(columns[0]), dtype=np.uint64)
    for column in columns:
        for values in column.reshape(len(column), -1).T:
            # Adding 0.0 turns -0.0 into 0.0.
            bits = (values.astype(np.float64) + 0.0).view(np.uint64)
            fingerprint = _mixed(fingerprint ^ bits)
    return fingerprint


def count_duplicates(fingerprints: UInt64[np.ndarray, " row"]) -> int:
    """Return the number of rows that are equal to another row before them."""
    return len(fingerprints) - len(np.unique(fingerprints))


def first_duplicate(fingerprints: UInt64[np.ndarray, " row"]) -> int | None:
    """Return the first row that is equal to another row before it, or None."""
    new = np.zeros(len(fingerprints), dtype=bool)
    new[np.unique(fingerprints, return_index=True)[1]] = True
    return None if new.all() else int(new.argmin())


def _cells(
    observation: Float[np.ndarray, "step dimension"],
    low: Float[np.ndarray, " dimension"],
    high: Float[np.ndarray, " dimension"],
) -> Int[np.ndarray, "step dimension"]:
    width = np.where(high > low, high - low, 1.0)
    cells: Int[np.ndarray, "step dimension"] = ((observation - low) / width * CELLS).clip(0, CELLS - 1).astype(np.int64)
    return cells


def _mixed(values: UInt64[np.ndarray, " row"]) -> UInt64[np.ndarray, " row"]:
    # The finaliser of SplitMix64 (Steele, Lea and Flood, 2014): every input bit reaches every output bit.
    values = values + np.uint64(0x9E3779B97F4A7C15)  # wraps around, as it should
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: UInt64[np.ndarray, " row"] = values ^ (values >> np.uint64(31))
    return mixed
