"""Why errors of long rollouts fall, where they do: whether by then much stands still, or at an end of its range.

A car that stands at a wall is where it was predicted to stand, whatever was wrong on the way. The median over rollouts
falls with every one that comes to rest, though no prediction got better.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Float64

from addressed_dynamics.episodes.transitions import Dimension

WINDOWS = 10
"""Parts of the rollouts, one after the other, that errors are compared in."""
FALLEN = 0.8
"""Errors fall if those of the last part are below this share of the largest of an earlier one."""
STILL = 1e-5
"""A state stands still if in a step no dimension changes by more than this share of its range."""
AT_BOUND = 1e-6
"""A dimension is at a bound if it is no farther from it than this share of their distance."""


def falling(
    percent: Float64[np.ndarray, "rollout step"],
    states: Float64[np.ndarray, "rollout time state"],
    dimensions: tuple[Dimension, ...],
    scale: Float64[np.ndarray, " state"],
) -> dict[str, Any] | None:
    """Return what is known of falling errors; None if they do not fall, or if rollouts are too short to tell.

    Args:
        percent: errors of one model, in % of the range.
        states: what really happened, the first before any action.
        dimensions: what the states mean.
        scale: range of each dimension.
    """
    parts = np.array_split(np.arange(percent.shape[1]), WINDOWS)
    if len(parts[-1]) < 2:
        return None
    medians = np.array([np.median(percent[:, part]) for part in parts])
    peak = int(medians.argmax())
    if medians[-1] >= FALLEN * medians[peak]:
        return None
    held = held_states(states, dimensions, scale)
    return {
        name: {
            "first_step": int(part[0]) + 1,
            "last_step": int(part[-1]) + 1,
            "percent": float(np.median(percent[:, part])),
            "held_share": float(held[:, part].mean()),
            "held_percent": _median(percent[:, part][held[:, part]]),
            "free_percent": _median(percent[:, part][~held[:, part]]),
        }
        for name, part in (("highest", parts[peak]), ("end", parts[-1]))
    }


def held_states(
    states: Float64[np.ndarray, "rollout time state"],
    dimensions: tuple[Dimension, ...],
    scale: Float64[np.ndarray, " state"],
) -> Bool[np.ndarray, "rollout step"]:
    """Return where the true state stands still in the step to it, or has a dimension at one of its bounds."""
    still = (np.abs(np.diff(states, axis=1)) <= STILL * scale).all(axis=-1)
    low, high = np.array([(each.low, each.high) for each in dimensions]).T
    slack = AT_BOUND * np.where(np.isfinite(high - low), high - low, 0.0)
    after = states[:, 1:]
    found: Bool[np.ndarray, "rollout step"] = still | ((after <= low + slack) | (after >= high - slack)).any(axis=-1)
    return found


def _median(values: Float64[np.ndarray, " value"]) -> float | None:
    return float(np.median(values)) if len(values) else None
