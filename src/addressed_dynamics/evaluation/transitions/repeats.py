"""How many test transitions stand in the training data too, and what a model makes of the others.

Episodes are kept whole when data are split, but two of them may begin in the same state, stand still at the same place,
or be logged twice: what was learned by heart is no test.
"""

from __future__ import annotations

from collections.abc import Callable
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
    blocks, scratch, truth = test.scratch.blocks, test.scratch, test.next_observation
    known = _rows(train, slice(len(train)))
    largest = np.max([np.abs(_rows(test, rows)).max(axis=0) for rows in blocks(len(test))], axis=0, initial=0.0)
    look = _search(known, largest)
    exact, alike = 0, scratch.array(len(test), torch.bool)
    for rows in blocks(len(test)):
        same, alike[rows] = look(_rows(test, rows))
        exact += int(same.sum())
    error = scratch.filled(len(test), lambda rows: (predicted[rows].numpy() - truth[rows]).astype(np.float64) ** 2)
    others = scratch.selected(error, lambda rows: ~alike[rows])
    scale = np.array(test.features.scale)
    return {
        "rows": len(test),
        "among": len(train),
        "exact": exact,
        "alike": int(np.count_nonzero(alike)),
        "percent": float(percent_of_range(error.mean(axis=0), scale)),
        "percent_without": float(percent_of_range(others.mean(axis=0), scale)) if len(others) else None,
    }


def repeated(
    rows: Float64[np.ndarray, "row column"], among: Float64[np.ndarray, "other column"]
) -> tuple[Bool[np.ndarray, " row"], Bool[np.ndarray, " row"]]:
    """Return which rows are equal to one of the others, and which are so but for rounding.

    Rounding is what float32 makes of the largest numbers of a column: no number is off by more than the step from the
    largest one, on either side, to the next.
    """
    return _search(among, np.abs(rows).max(axis=0, initial=0.0))(rows)


def _search(
    among: Float64[np.ndarray, "other column"], largest: Float64[np.ndarray, " column"]
) -> Callable[[Float64[np.ndarray, "row column"]], tuple[Bool[np.ndarray, " row"], Bool[np.ndarray, " row"]]]:
    """Return a function that does what `repeated` does for some of the rows, whose numbers are no larger than these."""
    largest = np.maximum(largest, np.abs(among).max(axis=0, initial=0.0))
    unit = np.spacing(largest.astype(np.float32)).astype(np.float64)
    others, known = np.unique(row_fingerprints(among), return_index=True)
    near = _nearby(among[known] / unit)

    def look(rows: Float64[np.ndarray, "row column"]) -> tuple[Bool[np.ndarray, " row"], Bool[np.ndarray, " row"]]:
        prints, first, place = np.unique(row_fingerprints(rows), return_index=True, return_inverse=True)
        exact = np.isin(prints, others)[place]
        return exact, exact | near(rows[first] / unit)[place]

    return look


def _nearby(
    among: Float64[np.ndarray, "other column"],
) -> Callable[[Float64[np.ndarray, "row column"]], Bool[np.ndarray, " row"]]:
    """Return a function that says which rows have one of these from which no number is farther than 1.

    Rows that are so near are near in any sum of their numbers, too, so only those have to be compared that are.
    """
    weights: Float64[np.ndarray, " column"] = np.random.default_rng(0).uniform(0.5, 1.0, (among.shape[1],))
    sums, reach = among @ weights, float(weights.sum()) + 1e-3
    order = np.argsort(sums, kind="stable")
    ordered = sums[order]

    def near(rows: Float64[np.ndarray, "row column"]) -> Bool[np.ndarray, " row"]:
        asked = rows @ weights
        begin, end = (np.searchsorted(ordered, asked + sign * reach) for sign in (-1, 1))
        found = np.zeros(len(rows), dtype=np.bool_)
        left = np.flatnonzero(begin < end)
        while len(left):
            found[left] = (np.abs(among[order[begin[left]]] - rows[left]) <= 1.0).all(axis=1)
            begin[left] += 1
            left = left[~found[left] & (begin[left] < end[left])]
        return found

    return near


def _rows(points: Points, rows: slice) -> Float64[np.ndarray, "chosen column"]:
    parts = [each[rows] for each in (points.observation, points.action, points.exogenous)]
    return np.concatenate([each.reshape(len(each), -1).astype(np.float64) for each in parts], axis=1)
