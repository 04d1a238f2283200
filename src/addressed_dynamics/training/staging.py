"""An epoch's samples in the order in which they are needed, for files that the system's cache does not hold.

A sample that is not in the cache is a read of its own when batches are gathered in random order, and takes forty times
as long as its share of an update. Here the samples are read once in their own order and written in that of the epoch,
stretch by stretch, before it begins. The order is the same permutation, and what is trained has the same bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import torch
from jaxtyping import Float, Int, Int64
from torch import Tensor

from addressed_dynamics.base.memory import free_memory
from addressed_dynamics.features.common.samples import Samples, Windows
from addressed_dynamics.features.common.spool import Mapped, beside, release

Gather = Callable[[Tensor], tuple[Tensor, Tensor]]
"""Rows (...) -> inputs (..., input) and targets (..., output)."""
STRETCH = 2**20
"""Samples that are needed one after the other and lie together: so many are in memory."""
READ_ROWS = 2**20
"""Samples that are read together."""


def gather_from(samples: Samples, order: Int[Tensor, "member position"] | None, batch_size: int) -> Gather:
    """Return what gathers samples, the fastest way that there is.

    Args:
        samples: the samples.
        order: rows that batches of `batch_size` will ask for, in turn; None if nobody knows.
        batch_size: columns of `order` in a batch.
    """
    if order is None or not _outgrows_the_cache(samples):
        return lambda rows: (samples.x[rows], samples.y[rows])
    return _Staged(samples, order, batch_size).gather


def _outgrows_the_cache(samples: Samples) -> bool:
    x = samples.x.frames if isinstance(samples.x, Windows) else samples.x
    size = x.numel() * x.element_size() + samples.y.numel() * samples.y.element_size()
    return isinstance(x, Mapped) and size > free_memory()


class _Staged:
    """Samples in the order of an epoch."""

    def __init__(self, samples: Samples, order: Int[Tensor, "member position"], batch_size: int) -> None:
        members, length = order.shape
        batches = max(STRETCH // (members * batch_size), 1)
        self._columns = [slice(first, first + batches * batch_size) for first in range(0, length, batches * batch_size)]
        self._ends = [min(columns.stop, length) * members for columns in self._columns]
        make = beside(samples)
        self._rows = make(order.numel(), dtype=order.dtype)
        self._x = make((order.numel(), samples.x.shape[1]))
        self._y = make((order.numel(), samples.y.shape[1]))
        for stretch, columns in zip(self._stretches(), self._columns, strict=True):
            self._rows[stretch] = order[:, columns].flatten().sort().values
        self._write(samples)
        self._left = self._stretches()
        self._load()

    def _stretches(self) -> Iterator[slice]:
        yield from (slice(begin, end) for begin, end in zip([0, *self._ends], self._ends, strict=False))

    def _write(self, samples: Samples) -> None:
        """Read all samples in their own order; write each wherever it is needed."""
        begins = [stretch.start for stretch in self._stretches()]
        for first in range(0, len(samples), READ_ROWS):
            x, y = samples.x[first : first + READ_ROWS], samples.y[first : first + READ_ROWS]
            for number, end in enumerate(self._ends):
                begin = begins[number]
                stop = begin + int(torch.searchsorted(self._rows[begin:end], first + len(x)))
                rows = self._rows[begin:stop].long() - first
                self._x[begin:stop], self._y[begin:stop] = x[rows], y[rows]
                begins[number] = stop
            release(samples.x, samples.y, self._rows, self._x, self._y)

    def _load(self) -> None:
        """Take the next stretch into memory."""
        stretch = next(self._left)
        self._of_stretch = self._rows[stretch].clone(), self._x[stretch].clone(), self._y[stretch].clone()
        release(self._rows, self._x, self._y)
        self._asked, self._size = 0, stretch.stop - stretch.start

    def gather(
        self, rows: Int64[Tensor, "*batch"]
    ) -> tuple[Float[Tensor, "*batch input"], Float[Tensor, "*batch output"]]:
        """Return the samples of the next batch."""
        if self._asked == self._size:
            self._load()
        self._asked += rows.numel()
        known, x, y = self._of_stretch
        place = torch.searchsorted(known, rows.to(known.dtype))
        return x[place], y[place]
