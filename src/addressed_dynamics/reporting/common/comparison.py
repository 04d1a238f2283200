"""Whether one model is better than another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import inf
from statistics import median
from typing import Literal

MARGIN = 1.1
"""One error counts as lower than another if it is so by more than this factor, from every seed."""
Relation = Literal["better", "worse", "unclear"]


@dataclass(frozen=True)
class Interval:
    """Where the other's error lies in multiples of ours, over what could have been held out."""

    low: float
    high: float

    @property
    def decides(self) -> bool:
        """Whether it leaves no doubt which of the two is lower."""
        return not self.low <= 1.0 <= self.high


UNKNOWN = Interval(0.0, inf)
"""What there are too few episodes for."""


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
    interval: Interval | None = None
    """From the lowest to the highest end of the intervals of the other's seeds; None where none was asked for."""

    def medians(self, number: Callable[[float], str]) -> str:
        """Return both medians as part of a sentence, written by `number`."""
        return f"{self.quantity} {number(median(self.own))} against {number(median(self.other))}"


def relate(own: Sequence[float], other: Sequence[float], intervals: Sequence[Interval] = ()) -> Relation:
    """Say whether our errors (one per seed) are lower, and so better: from every seed, and by more than `MARGIN`.

    Where there are intervals, none of them may have 1 in it.
    """
    if not all(interval.decides for interval in intervals):
        return "unclear"
    if max(own) * MARGIN < min(other):
        return "better"
    return "worse" if max(other) * MARGIN < min(own) else "unclear"
