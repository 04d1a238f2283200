"""Errors in % of the range, and how long rollouts keep theirs low: what candidates are compared and recommended by."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

LOST_PERCENT = 10.0
"""A rollout is lost when its error has grown to this share of the range."""


def percent_of_range(
    squared: Float64[np.ndarray, "*batch state"], scale: Float64[np.ndarray, " state"]
) -> Float64[np.ndarray, "*batch"]:
    """Return the root mean square over the dimensions of the state, each in % of its range."""
    percent: Float64[np.ndarray, "*batch"] = 100 * np.sqrt((squared / scale**2).mean(axis=-1))
    return percent


def one_step_percent(dimensions: Sequence[Mapping[str, Any]], scale: Float64[np.ndarray, " state"]) -> float:
    """Return the same of the one-step errors that `errors_per_dimension` gives; angles are not counted twice."""
    means = [each["squared"]["mean"] for each in dimensions[: len(scale)]]
    return float(percent_of_range(np.array(means), scale))


def median_course(
    squared: Float64[np.ndarray, "rollout step state"], scale: Float64[np.ndarray, " state"]
) -> Float64[np.ndarray, " step"]:
    """Return the error after each step, in % of the range, of the rollout that is the median there."""
    course: Float64[np.ndarray, " step"] = np.median(percent_of_range(squared, scale), axis=0)
    return course


def steps_until_lost(course: Float64[np.ndarray, " step"]) -> int | None:
    """Return the steps until a rollout with such errors, in % of the range, is lost; None if it never is."""
    lost = np.flatnonzero(course >= LOST_PERCENT)
    return int(lost[0]) + 1 if len(lost) else None
