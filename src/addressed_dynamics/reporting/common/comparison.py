"""Whether one model is better than another."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

MARGIN = 1.1
"""One error counts as lower than another if it is so by more than this factor, from every seed."""


Relation = Literal["lower", "higher", "unclear"]


def relate(own: Sequence[float], other: Sequence[float]) -> Relation:
    """Say whether our errors (one per seed) are lower than another's: from every seed, and by more than `MARGIN`."""
    if max(own) * MARGIN < min(other):
        return "lower"
    return "higher" if max(other) * MARGIN < min(own) else "unclear"
