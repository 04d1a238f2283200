"""What a training loop yields, and how a pass over the bins is cut into batches."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Self

import torch
from jaxtyping import Float, Int, Int64, Shaped
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.torch_runtime import CPU, sent
from addressed_dynamics.networks.stacked import StackedMLP

BLOCK_ROWS = 2**20
"""Samples that are looked at together where those of a bin are listed."""


@dataclass(frozen=True)
class Epoch:
    """One finished epoch of training."""

    index: int
    """Number of the epoch, from 1."""
    last: bool
    """Whether training ends with it."""
    updates: int
    """Updates made so far."""
    metrics: dict[str, float]
    """What was measured in it; losses are of states scaled to [0, 1]."""
    network: StackedMLP
    """The networks as they are now; they change in place when the loop goes on."""
    samples: int = 0
    """Samples seen so far by all networks together: every time that one is in a batch counts."""


@dataclass(frozen=True)
class Batch:
    """Rows for one update: each member's own."""

    rows: Int64[Tensor, "member sample"]
    """Indices into the samples."""
    weight: Float[Tensor, "member sample"]
    """Weight of each sample in its member's loss; they add up to 1 for each member that has samples."""


@dataclass(frozen=True)
class Order:
    """One pass of every member over its own bin, in random order."""

    rows: Int[Tensor, "member position"]
    """Indices into the samples, as each member takes them."""
    idle: tuple[int, ...]
    """Members without samples."""
    one_short: tuple[int, ...]
    """Members whose last row is none of their own pass."""

    def on(self, device: torch.device) -> Self:
        """Return the same on a device, for all batches at once: to send each costs as much as to train on it."""
        return replace(self, rows=self.rows.to(device))

    def batches(self, batch_size: int) -> Iterator[Batch]:
        """Yield the pass in batches, where it lies."""
        members, length = self.rows.shape
        weight = torch.ones(members, batch_size)
        weight[[*self.idle]] = 0.0
        share = _shares(weight).to(self.rows.device)
        for start in range(0, length, batch_size):
            if start + batch_size >= length:
                part = weight[:, : length - start]
                if self.one_short:
                    part[[*self.one_short], -1] = 0.0
                share = _shares(part).to(self.rows.device)
            yield Batch(self.rows[:, start : start + batch_size].long(), share)


def draw_order(bins: Shaped[Tensor, " sample"], members: int, generator: torch.Generator) -> Order:
    """Draw one pass of every member over its own bin, on the CPU, where `bins` are.

    All members take ceil(N/n) rows, so that every binning costs the same number of updates. With equal bins that is
    each sample once (a bin that is one short repeats a row at weight 0). A larger bin gives a random part of itself,
    a smaller one repeats itself, and a member without samples has weight 0 throughout.
    """
    length = math.ceil(len(bins) / members)
    rows = torch.zeros(members, length, dtype=row_dtype(len(bins)))
    idle, one_short = list[int](), list[int]()
    for member in range(members):
        own = rows_where(bins, member)
        if not len(own):
            idle.append(member)
            continue
        for first in range(0, length, len(own)):
            order = torch.randperm(len(own), generator=generator, dtype=own.dtype)[: length - first]
            torch.index_select(own, 0, order, out=rows[member, first : first + len(own)])
        if len(own) == length - 1:
            one_short.append(member)
    return Order(rows, tuple(idle), tuple(one_short))


def batches(
    bins: Shaped[Tensor, " sample"],
    members: int,
    batch_size: int,
    generator: torch.Generator,
    device: torch.device = CPU,
) -> Iterator[Batch]:
    """Yield one pass of every member over its own bin, in random order, in batches on a device; see `draw_order`."""
    yield from draw_order(bins, members, generator).on(device).batches(batch_size)


def _shares(weight: Float[Tensor, "member sample"]) -> Float[Tensor, "member sample"]:
    return weight / weight.sum(dim=1, keepdim=True).clamp(min=1.0)


def row_dtype(samples: int) -> torch.dtype:
    """Return the smaller type that the numbers of so many rows fit into."""
    return torch.int32 if samples < 2**31 else torch.int64


def rows_where(values: Shaped[Tensor, " sample"], value: int) -> Int[Tensor, " row"]:
    """Return the rows that have a value, block by block: of all at once, each would take 8 bytes more."""
    blocks = range(0, len(values), BLOCK_ROWS)
    counts = [int((values[first : first + BLOCK_ROWS] == value).count_nonzero()) for first in blocks]
    rows, begin = torch.empty(sum(counts), dtype=row_dtype(len(values))), 0
    for first, count in zip(blocks, counts, strict=True):
        found = torch.nonzero(values[first : first + BLOCK_ROWS] == value).squeeze(1)
        rows[begin : begin + count] = found + first
        begin += count
    return rows


def overlapping(
    passed: Iterable[Batch], near: Shaped[Tensor, " sample"], members: int, share: float, generator: torch.Generator
) -> Iterator[Batch]:
    """Yield batches in which a share of each member's samples are others, drawn from those that it is near to.

    Args:
        passed: batches of the members' own bins.
        near: for each sample, the member that is near to it and does not have it in its bin; on the CPU.
        members: how many members there are; one that is near to nothing keeps its batches.
        share: share of the samples.
        generator: what draws.
    """
    neighbours = [rows_where(near, member) for member in range(members)]
    for batch in passed:
        rows = batch.rows.clone()
        drawn = round(share * rows.shape[1])
        for member, others in enumerate(neighbours):
            if len(others):
                found = others[torch.randint(0, len(others), (drawn,), generator=generator)].long()
                rows[member, :drawn] = sent(found, rows.device)
        yield Batch(rows, batch.weight)


def updates_per_epoch(samples: int, members: int, batch_size: int) -> int:
    """Return the number of batches that `batches` yields."""
    return math.ceil(math.ceil(samples / members) / batch_size)


@dataclass(frozen=True)
class Length:
    """How long a training is, of which the last epoch may be cut short."""

    updates: int
    """Updates in all."""
    per_epoch: int
    """Updates of a whole epoch."""
    samples: int
    """Samples to train on."""
    members: int
    """Networks that share them."""
    batch_size: int
    """Samples per member and update."""

    @staticmethod
    def of(samples: int, members: int, batch_size: int, *, epochs: int, updates: int | None = None) -> "Length":
        """Return the length of a training of `epochs` epochs, or of exactly `updates` updates, if they are given.

        Raises:
            TrainingError: so many updates are none, or more than the epochs have.
        """
        per_epoch = updates_per_epoch(samples, members, batch_size)
        most = epochs * per_epoch
        if updates is not None and not 1 <= updates <= most:
            message = (
                f"a training of {epochs} epochs of {per_epoch} updates can stop after 1 to {most} updates, but not "
                f"after {updates}: give it more epochs"
            )
            raise TrainingError(message)
        return Length(most if updates is None else updates, per_epoch, samples, members, batch_size)

    @property
    def epochs(self) -> int:
        """Number of epochs, that which is cut short included."""
        return math.ceil(self.updates / self.per_epoch)

    def updates_after(self, epoch: int) -> int:
        """Return the updates made when `epoch` (from 1) ends."""
        return min(epoch * self.per_epoch, self.updates)

    def updates_in(self, epoch: int) -> int:
        """Return the updates of `epoch`: those of a whole one, unless it is the last and cut short."""
        return self.updates_after(epoch) - self.updates_after(epoch - 1)

    def samples_after(self, epoch: int) -> int:
        """Return the samples that all members together have seen when `epoch` ends; a whole epoch shows each once."""
        whole, rest = divmod(self.updates_after(epoch), self.per_epoch)
        return whole * self.samples + min(rest * self.batch_size * self.members, self.samples)
