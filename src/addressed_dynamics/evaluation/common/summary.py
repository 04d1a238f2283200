"""The headline of an evaluation: the few numbers that are in Git, and that `dvc metrics diff` compares."""

import math
from collections.abc import Mapping

DECIMALS = 5
"""What DVC shows of a number; a difference that is not shown should not be there."""


def rounded(figures: Mapping[str, float | None]) -> dict[str, float]:
    """Return the figures as they are kept: rounded, and without those that are not known or not finite."""
    return {
        name: round(value, DECIMALS) for name, value in figures.items() if value is not None and math.isfinite(value)
    }


def log10_of(squared_error: float | None) -> float | None:
    """Return the base-10 logarithm of a squared error; None of 0 or of nothing."""
    return math.log10(squared_error) if squared_error else None
