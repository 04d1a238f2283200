"""Whether one model is better than another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

MARGIN = 1.1
"""One error counts as lower than another if it is so by more than this factor, from every seed."""
Relation = Literal["better", "worse", "unclear"]


@dataclass(frozen=True)
class Comparison:
    """One figure of our model beside that of another, each from some seeds."""

    quantity: str
    """What it is, as part of a sentence."""
    own: tuple[float, ...]
    """Ours, from each seed."""
    other: tuple[float, ...]
    """The other's, from each of its seeds."""
    relation: Relation
    """Whether ours is better."""

    def medians(self, number: Callable[[float], str]) -> str:
        """Return both medians as part of a sentence, written by `number`."""
        return f"{self.quantity} {number(median(self.own))} against {number(median(self.other))}"


def relate(own: Sequence[float], other: Sequence[float]) -> Relation:
    """Say whether our errors (one per seed) are lower, and so better: from every seed, and by more than `MARGIN`."""
    if max(own) * MARGIN < min(other):
        return "better"
    return "worse" if max(other) * MARGIN < min(own) else "unclear"
