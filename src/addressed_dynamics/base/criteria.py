"""What models are compared by, and which of two is better."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Criterion:
    """A figure that models are compared by."""

    name: str
    """What it is, with its unit, for instance `horizon_seconds`."""
    value: float
    """What the model reaches."""
    higher_is_better: bool
    """Whether more is better; if not, less is."""
    tie: float = 0.0
    """Values that differ by no more than this are as good as each other."""


def is_better(criteria: Sequence[Criterion], other: Mapping[str, float]) -> bool:
    """Return whether a model is better than another: the first one decides in which they are not as good.

    Args:
        criteria: of the model, the one that counts most first.
        other: values of the other one, by name; one for each.
    """
    for each in criteria:
        gain = each.value - other[each.name] if each.higher_is_better else other[each.name] - each.value
        if abs(gain) > each.tie:
            return gain > 0
    return False
