"""How many test transitions stand in the training data too, and what a model makes of the others.

Episodes are kept whole when data are split, but two of them may begin in the same state, stand still at the same place,
or be logged twice: what was learned by heart is no test.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from addressed_dynamics.episodes.fingerprints import row_fingerprints
from addressed_dynamics.evaluation.transitions.horizons import percent_of_range
from addressed_dynamics.evaluation.transitions.points import Points


def repeats(train: Points, test: Points, predicted: Float[Tensor, "point observation"]) -> dict[str, Any]:
    """Return how many test transitions begin as one of the training does, and the errors without them.

    A row is the state, the action and the exogenous inputs of a step; of several frames, those of the last.

    Args:
        train: what models were trained on.
        test: what is judged.
        predicted: next states of the test transitions, by the model that is delivered.
    """
    exact, alike = repeated(_rows(test), _rows(train))
    error = (predicted - torch.from_numpy(test.next_observation)).double().square().numpy()
    scale = np.array(test.features.scale)
    return {
        "rows": len(test),
        "among": len(train),
        "exact": int(exact.sum()),
        "alike": int(alike.sum()),
        "percent": float(percent_of_range(error.mean(axis=0), scale)),
        "percent_without": float(percent_of_range(error[~alike].mean(axis=0), scale)) if not alike.all() else None,
    }


def repeated(
    rows: Float64[np.ndarray, "row column"], among: Float64[np.ndarray, "other column"]
) -> tuple[Bool[np.ndarray, " row"], Bool[np.ndarray, " row"]]:
    """Return which rows are equal to one of the others, and which are so but for rounding.

    Rounding is what float32 makes of the largest numbers of a column: no number is off by more than the step from the
    largest one, on either side, to the next.
    """
    largest = np.maximum(np.abs(rows).max(axis=0, initial=0.0), np.abs(among).max(axis=0, initial=0.0))
    unit = np.spacing(largest.astype(np.float32)).astype(np.float64)
    prints, others = row_fingerprints(rows), row_fingerprints(among)
    _, first, place = np.unique(prints, return_index=True, return_inverse=True)
    alike = _near(rows[first] / unit, among[np.unique(others, return_index=True)[1]] / unit)
    exact = np.isin(prints, others)
    return exact, exact | alike[place]


def _near(
    rows: Float64[np.ndarray, "row column"], among: Float64[np.ndarray, "other column"]
) -> Bool[np.ndarray, " row"]:
    """Return which rows have another from which no number is farther than 1.

    Rows that are so near are near in any sum of their numbers, too, so only those have to be compared that are.
    """
    weights: Float64[np.ndarray, " column"] = np.random.default_rng(0).uniform(0.5, 1.0, (rows.shape[1],))
    sums, asked, reach = among @ weights, rows @ weights, float(weights.sum()) + 1e-3
    order = np.argsort(sums, kind="stable")
    begin, end = (np.searchsorted(sums[order], asked + sign * reach) for sign in (-1, 1))
    found = np.zeros(len(rows), dtype=np.bool_)
    left = np.flatnonzero(begin < end)
    while len(left):
        found[left] = (np.abs(among[order[begin[left]]] - rows[left]) <= 1.0).all(axis=1)
        begin[left] += 1
        left = left[~found[left] & (begin[left] < end[left])]
    return found


def _rows(points: Points) -> Float64[np.ndarray, "point column"]:
    parts = (points.observation, points.action, points.exogenous)
    return np.concatenate([each.reshape(len(points), -1).astype(np.float64) for each in parts], axis=1)
