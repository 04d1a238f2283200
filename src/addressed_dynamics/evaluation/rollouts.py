"""Free-running rollouts: a model follows its own predictions from a true first state under the recorded actions."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from addressed_dynamics.evaluation.truth import TrueRollouts
from addressed_dynamics.models.addressed import AddressedDynamics, Mode
from addressed_dynamics.transitions import Dimension

LEFT_BOUNDS_TOLERANCE = 0.01
"""A predicted state has left the bounds when it lies outside by more than this share of their range."""


def rollout_errors(
    model: AddressedDynamics, truth: TrueRollouts, mode: Mode
) -> tuple[Float64[np.ndarray, "episode step observation"], Float64[np.ndarray, "episode step observation"]]:
    """Return the squared errors of a model's open-loop rollouts, and the predicted states, in environment units."""
    first = truth.states[:, 0].astype(np.float32)
    generator = torch.Generator().manual_seed(0)  # the same report from the same models, in the mode `sample` too
    predicted = model.rollout(first, truth.actions, mode, generator=generator).astype(np.float64)
    # A diverged rollout must count as a large error, and JSON cannot hold what is not finite.
    predicted = np.nan_to_num(predicted, nan=1e6, posinf=1e6, neginf=-1e6).clip(-1e6, 1e6)
    return (predicted - truth.states[:, 1:]) ** 2, predicted


def summarise_rollouts(
    squared: Float64[np.ndarray, "episode step observation"],
    predicted: Float64[np.ndarray, "episode step observation"],
    truth: TrueRollouts,
    dimensions: tuple[Dimension, ...],
) -> dict[str, Any]:
    """Return the mean squared error of whole rollouts per dimension, over each group of episodes.

    `left_bounds_share` is the share of rollouts in which a predicted state leaves the bounds; None if there are none.
    """
    per_episode = squared.mean(axis=1)
    summary: dict[str, Any] = {"left_bounds_share": _left_bounds_share(predicted, dimensions)}
    for name, members in truth.groups.items():
        summary[name] = {
            "episodes": int(members.sum()),
            "mse": {
                dimension.name: _spread(per_episode[members, index]) if members.any() else None
                for index, dimension in enumerate(dimensions)
            },
        }
    return summary


def _left_bounds_share(
    predicted: Float64[np.ndarray, "episode step observation"], dimensions: tuple[Dimension, ...]
) -> float | None:
    low, high = np.array([(dimension.low, dimension.high) for dimension in dimensions]).T
    if not np.isfinite([low, high]).any():
        return None
    slack = LEFT_BOUNDS_TOLERANCE * np.where(np.isfinite(high - low), high - low, 0.0)
    outside = ((predicted < low - slack) | (predicted > high + slack)).any(axis=(1, 2))
    return float(outside.mean())


def error_against_horizon(
    squared: Float64[np.ndarray, "episode step observation"], dimensions: tuple[Dimension, ...], every: int
) -> list[dict[str, float]]:
    """Return rows for a table: squared error at each horizon (10th, 50th and 90th percentile over episodes)."""
    rows = []
    for horizon in range(every, squared.shape[1] + 1, every):
        row: dict[str, float] = {"horizon": horizon}
        for index, dimension in enumerate(dimensions):
            values = np.quantile(squared[:, horizon - 1, index], [0.1, 0.5, 0.9])
            row |= {
                f"{dimension.name}_{label}": float(v) for label, v in zip(("p10", "p50", "p90"), values, strict=True)
            }
        rows.append(row)
    return rows


def _spread(values: Float64[np.ndarray, " episode"]) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "p10": float(np.quantile(values, 0.1)),
        "p90": float(np.quantile(values, 0.9)),
        "max": float(values.max()),
    }
