"""The noise floor of data: what differs between steps that begin alike, as their distance goes to zero."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

NEIGHBOURS = 10
"""Neighbours of a step that are compared with it."""


@dataclass(frozen=True)
class Noise:
    """The noise in some outcomes."""

    variance: Float64[np.ndarray, " outcome"]
    absolute: Float64[np.ndarray, " outcome"]
    """Mean absolute value: of noise with such a variance, and as long tails as the differences between neighbours."""


def find_noise(
    inputs: Float64[np.ndarray, "row input"],
    outcomes: Float64[np.ndarray, "row outcome"],
    among: tuple[Float64[np.ndarray, "other input"], Float64[np.ndarray, "other outcome"]] | None = None,
    neighbours: int = NEIGHBOURS,
) -> Noise | None:
    """Return the noise in each outcome, by the gamma test (Stefánsson, Končar and Jones 1997).

    Half of the mean squared difference between the outcomes of a row and of its k-th neighbour is a line over their
    squared distance, whose value at distance zero is the variance of the noise.

    Args:
        inputs: what a step begins with, in units that make distances comparable.
        outcomes: what comes of it.
        among: inputs and outcomes of the rows that neighbours are looked for in; None for the same rows, of which none
            is a neighbour of itself.
        neighbours: how many are compared with each row, or as many as there are.

    Returns:
        The noise; None with fewer than two neighbours, or without rows.
    """
    others, their_outcomes = (inputs, outcomes) if among is None else among
    itself = among is None
    count = min(neighbours, len(others) - itself)
    if count < 2 or not len(inputs):
        return None
    distances, nearest = cKDTree(others).query(inputs, count + itself)
    if itself:
        distances, nearest = _without_itself(distances, nearest)
    squared = (distances**2).mean(axis=0)
    differences = their_outcomes[nearest] - outcomes[:, None]
    half = 0.5 * (differences**2).mean(axis=0)
    variance = np.array([_at_zero(squared, column) for column in half.T])
    size = np.sqrt(2 * half[0])
    shape = np.abs(differences[:, 0]).mean(axis=0) / np.where(size > 0, size, 1.0)
    return Noise(variance, np.sqrt(variance) * shape)


def _without_itself(
    distances: Float64[np.ndarray, "row found"], nearest: np.ndarray
) -> tuple[Float64[np.ndarray, "row neighbour"], np.ndarray]:
    """Leave each row out of its own neighbours, or the farthest of them where copies of the row took its place."""
    others = nearest != np.arange(len(nearest))[:, None]
    others[others.all(axis=1), -1] = False
    shape = (len(nearest), nearest.shape[1] - 1)
    return distances[others].reshape(shape), nearest[others].reshape(shape)


def _at_zero(distances: Float64[np.ndarray, " neighbour"], differences: Float64[np.ndarray, " neighbour"]) -> float:
    slope, at_zero = np.polyfit(distances, differences, 1) if np.ptp(distances) > 0 else (0.0, differences.mean())
    # A line that bends down near zero would give less than nothing; what is left of it is no noise.
    return float(np.clip(at_zero if slope >= 0 else differences[0], 0.0, differences[0]))
