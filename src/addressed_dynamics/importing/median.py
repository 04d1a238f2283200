"""The exact median of more numbers than fit in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from jaxtyping import Int64

BINS = 2**12
"""Parts in which the range of the numbers is divided at each look at them."""

Blocks = Callable[[], Iterable[Int64[np.ndarray, " number"]]]
"""Begins to go through the numbers, which are not negative; done several times."""


def median(blocks: Blocks) -> float | None:
    """Return what `np.median` does of all numbers at once; None if there is none."""
    count, low, high = 0, np.iinfo(np.int64).max, 0
    for each in blocks():
        if len(each):
            count, low, high = count + len(each), min(low, int(each.min())), max(high, int(each.max()))
    if not count:
        return None
    middle = {(count - 1) // 2, count // 2}
    return float(np.mean([_in_order(blocks, place, low, high) for place in middle]))


def _in_order(blocks: Blocks, place: int, low: int, high: int) -> int:
    """Return the number at `place` if they were sorted, of those between `low` and `high`."""
    while low < high:
        width = (high - low) // BINS + 1
        counts = np.zeros(BINS, dtype=np.int64)
        for each in blocks():
            inside = each[(each >= low) & (each <= high)]
            counts += np.bincount((inside - low) // width, minlength=BINS)
        part = int(np.searchsorted(np.cumsum(counts), place, side="right"))
        place -= int(counts[:part].sum())
        low += part * width
        high = min(high, low + width - 1)
    return low
