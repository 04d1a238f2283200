"""What rollouts are off by after a step, 1 s and 10 s of the simulated time: errors as a user asks for them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.evaluation.transitions.horizons import median_course, percent_of_range

SECONDS = (1.0, 10.0)
"""Times of the simulated clock at which errors are told, beside those after one step."""
STEPS = (10, 100)
"""Steps in their place, where a step has no duration."""


def moments(step_seconds: float, longest: int) -> tuple[int, ...]:
    """Return the steps after which errors are told, rising and each once, as far as rollouts last.

    They are the first and those that end nearest to `SECONDS`: a rollout begins at 0 s, and step k ends k steps later.

    Args:
        step_seconds: length of a step; 0 if it has none.
        longest: steps of a rollout.
    """
    later = [round(seconds / step_seconds) for seconds in SECONDS] if step_seconds > 0 else STEPS
    return tuple(sorted({step for step in (1, *later) if 1 <= step <= longest}))


def errors_after(
    steps: Sequence[int],
    squared: Float64[np.ndarray, "rollout step state"],
    scale: Float64[np.ndarray, " state"],
    names: Sequence[str],
    half: Float64[np.ndarray, "rollout step state"] | None = None,
) -> list[dict[str, Any]]:
    """Return the errors of one candidate after so many steps of its rollouts, as `ErrorAfter` has them.

    Args:
        steps: as `moments` has them.
        squared: squared errors of rollouts, in units of the state.
        scale: range of each dimension.
        names: of the dimensions.
        half: half of the intervals around each state, infinite where none is known; None of what has none.
    """
    course = median_course(squared, scale)
    found = []
    for step in steps:
        mean = squared[:, step - 1].mean(axis=0)
        found.append(
            {
                "name": f"after_{step}_steps",
                "steps": step,
                "rollouts": len(squared),
                "percent": float(percent_of_range(mean, scale)),
                "median_percent": float(course[step - 1]),
                "dimensions": dict(zip(names, np.sqrt(mean).tolist(), strict=True)),
                "interval": None if half is None else _interval(half[:, step - 1], names),
            }
        )
    return found


def _interval(half: Float64[np.ndarray, "rollout state"], names: Sequence[str]) -> dict[str, float] | None:
    median = np.median(half, axis=0)
    return dict(zip(names, median.tolist(), strict=True)) if np.isfinite(median).all() else None
