"""The noise floor of an experiment's data one step ahead, by nearest neighbours.

In a world without noise it is what the data leave open where they are thin or the world jumps, as at a wall: there a
model may be below it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64, Int64

from addressed_dynamics.episodes.noise import NEIGHBOURS, find_noise
from addressed_dynamics.evaluation.transitions.points import Points

MOST_POINTS = 2_000
"""Test transitions, evenly spread, whose neighbours are looked for."""
MOST_FITTED = 100_000
"""Training transitions, evenly spread, that the linear map is fitted to."""


def noise_floor(train: Points, test: Points, loss: str) -> dict[str, Any] | None:
    """Return what cannot be predicted of the test transitions; None with fewer than two training transitions.

    Each is compared with its nearest neighbours among all training transitions, by a network's inputs. What is compared
    is the change of the state in a step, less the best linear map of the inputs: over the distance to a neighbour the
    rest changes least, so that the line to distance zero is short.

    Args:
        train: where neighbours are looked for.
        test: of which at most `MOST_POINTS` are judged.
        loss: `mse` or `mae`, of states scaled to [0, 1].
    """
    features, rows = test.features, _spread(len(test), MOST_POINTS)
    (given, changes), (asked, true) = _steps(train, np.arange(len(train))), _steps(test, rows)
    fitted = _spread(len(train), MOST_FITTED)
    weights = np.linalg.lstsq(_with_one(given[fitted]), changes[fitted], rcond=None)[0]
    rest, asked_rest = (y - _with_one(x) @ weights for x, y in ((given, changes), (asked, true)))
    noise = find_noise(asked, asked_rest, (given, rest))
    if noise is None:
        return None
    scale, predicted = np.array(features.scale), list(features.predicted)
    variance, absolute = noise.variance / scale**2, noise.absolute / scale
    return {
        "neighbours": min(NEIGHBOURS, len(train)),
        "transitions": len(rows),
        "among": len(train),
        "scaled": float((variance if loss == "mse" else absolute)[predicted].mean()),
        "percent": 100 * math.sqrt(variance.mean()),
        "absolute": dict(zip(features.spaces.observation_names, noise.absolute.tolist(), strict=True)),
    }


def _steps(
    points: Points, rows: Int64[np.ndarray, " chosen"]
) -> tuple[Float64[np.ndarray, "chosen input"], Float64[np.ndarray, "chosen observation"]]:
    """Return a network's inputs, and the changes of the state, in the environment's units."""
    change = points.next_observation[rows].astype(np.float64) - points.observation[rows]
    return points.x(points.features)[torch.from_numpy(rows)].to(torch.float64).numpy(), change


def _with_one(x: Float64[np.ndarray, "row input"]) -> Float64[np.ndarray, "row more"]:
    return np.column_stack([x, np.ones(len(x))])


def _spread(count: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
