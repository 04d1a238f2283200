"""Algorithm 1 of the paper: give every sample to one subnetwork, by loss, in equally large bins."""

import math
from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction

import torch
from jaxtyping import Bool, Float, Int32, Int64, Shaped
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.features.common.spool import release
from addressed_dynamics.networks.stacked import BLOCKS_HELD

SINKHORN_ROUNDS = 30
"""Rounds in which drawn bins become equally large."""
ROWS_ON_CPU = 2**16
"""Samples that a pass looks at together: so many stay in a processor's cache."""
ROWS_ELSEWHERE = 2**24
"""The same on a device where every call costs time."""
FIRST_DIGIT, NEXT_DIGIT = 11, 10
"""Bits of a norm that are counted at first, and then among those that are still in question."""
Make = Callable[..., Tensor]
"""Makes an empty tensor: (shape, dtype=, device=) -> tensor; where it lies is up to it."""


def assign_to_bins(losses: Float[Tensor, "sample member"], slack: float = 0.0) -> Int64[Tensor, " sample"]:
    """Assign each sample to a member so that all bins hold N/n samples (the paper, Section 2, Algorithm 1).

    Samples are taken in descending L2 norm of their loss profile (equal norms: in the order given). Each goes to its
    lowest-loss member whose bin has room (equal losses: to the lower index). The paper is silent about an N that n
    does not divide: here the first N mod n members take one sample more, and none is dropped. The printed listing
    loops `while len(Ls) < 0`; it means: until the list is empty.

    With slack (the paper has none) a bin has room for ceil((1 + slack) N/n) samples: from n - 1 on, all samples
    find room with their best member.

    Works in at most n phases instead of N steps: as long as no bin fills up, every remaining sample's choice is known
    at once. A phase ends at the first sample that finds its bin full; that bin is closed, and the rest choose again.
    Nothing is sorted: which sample that is, is a rank among those that choose the bin, and found by counting the digits
    of their norms in passes over the samples in the order given. So losses may lie in a file that is mapped.

    Args:
        losses: loss profile of each sample: its loss under each member, in any unit, finite.
        slack: share by which a bin may be larger than N/n.

    Returns:
        The member each sample is assigned to, in 0..n-1, on the device of `losses`.

    Raises:
        TrainingError: `losses` is not a matrix with at least one member, or holds a value that is not finite.
    """
    return small_bins(losses, slack).long()


def small_bins(
    losses: Float[Tensor, "sample member"], slack: float = 0.0, *, make: Make = torch.empty
) -> Shaped[Tensor, " sample"]:
    """Return what `assign_to_bins` does, as integers that are no larger than they have to be.

    Args:
        losses: loss profile of each sample.
        slack: share by which a bin may be larger than N/n.
        make: makes an empty tensor of a shape, a data type and a device, for 4 bytes of each sample (8 of float64).
    """
    _check_shape(losses)
    return _Assignment(losses, slack, make).bins


class _Assignment:
    """Algorithm 1 while it runs."""

    def __init__(self, losses: Float[Tensor, "sample member"], slack: float, make: Make) -> None:
        samples, self._members = losses.shape
        self._losses = losses
        self._room = _room(samples, self._members, slack)
        self._closed = self._room == 0
        small = bins_dtype(self._members)
        self._open = torch.iinfo(small).max
        self._preferred = torch.empty(samples, dtype=small, device=losses.device)
        double = losses.dtype == torch.float64
        self._bits, self._float, self._key = (
            (63, torch.float64, torch.int64) if double else (31, torch.float32, torch.int32)
        )
        self._keys = make(samples, dtype=self._key, device=losses.device)
        self.bins = torch.full_like(self._preferred, self._open)
        """Each sample's member; the largest value of the type as long as it has none."""
        self._rows = ROWS_ON_CPU if losses.device.type == "cpu" else ROWS_ELSEWHERE
        shift = self._bits - FIRST_DIGIT
        counts = self._counted_at_first(shift)
        while (key := self._where_a_bin_overflows(counts, shift)) is not None:
            full = self._assign_up_to(*key)
            self._closed[full] = True
            counts = self._counted_again(shift, full)
        for rows in self._blocks():
            self.bins[rows] = torch.where(self.bins[rows] == self._open, self._preferred[rows], self.bins[rows])

    def _blocks(self) -> Iterator[slice]:
        for number, first in enumerate(range(0, len(self._losses), self._rows)):
            yield slice(first, first + self._rows)
            if not number % BLOCKS_HELD:
                release(self._losses, self._keys)

    def _counted_at_first(self, shift: int) -> Int64[Tensor, "member digit"]:
        """Find every sample's norm and its best member; count them by member and first digit."""
        counts = self._none_counted(shift, self._bits)
        for rows in self._blocks():
            part = self._losses[rows].contiguous()
            _check_finite(part)
            # Norms are not negative, and the bits of such numbers, taken for integers, are in the same order.
            # They are the CPU's wherever the losses lie: of many samples rounding alone tells some norms apart, and
            # another way of adding up squares would put these in another order.
            norms = torch.linalg.vector_norm(part.cpu(), dim=1).to(self._float).view(self._key)
            self._keys[rows] = norms.to(part.device)
            self._preferred[rows] = _lowest_open(part.T.contiguous(), self._closed).to(self._preferred.dtype)
            counts += self._count(self._preferred[rows], self._keys[rows] >> shift, counts.shape[1])
        return counts

    def _counted_again(self, shift: int, closed: int) -> Int64[Tensor, "member digit"]:
        """Let those choose again whose bin was closed, and count all that have none yet."""
        counts = self._none_counted(shift, self._bits)
        for rows in self._blocks():
            left = torch.nonzero(self.bins[rows] == self._open).squeeze(1)
            preferred = self._preferred[rows][left]
            again = torch.nonzero(preferred == closed).squeeze(1)
            if len(again):
                columns = self._losses[rows][left[again]].T.contiguous()
                preferred[again] = _lowest_open(columns, self._closed).to(preferred.dtype)
                self._preferred[rows][left[again]] = preferred[again]
            counts += self._count(preferred, self._keys[rows][left] >> shift, counts.shape[1])
        return counts

    def _where_a_bin_overflows(
        self, counts: Int64[Tensor, "member digit"], shift: int
    ) -> tuple[int, dict[int, int]] | None:
        """Return the norm of the first sample without room, as a key, if there is one.

        Beside it, for each member whose bin overflows among the samples of this very norm: for how many of them it has
        room.
        """
        totals = counts.sum(dim=1)
        ranks = {
            m: int(self._room[m]) for m in range(self._members) if not self._closed[m] and totals[m] > self._room[m]
        }
        if not ranks:
            return None
        prefix, before = 0, self._bits
        while True:
            # From the largest norm down: the first digit by which a member has more samples than room.
            downwards = dict(zip(ranks, counts[[*ranks]].flip(1).cumsum(dim=1), strict=True))
            places = {m: int(torch.searchsorted(downwards[m], rank, right=True)) for m, rank in ranks.items()}
            first = min(places.values())
            ranks = {
                m: rank - (int(downwards[m][first - 1]) if first else 0)
                for m, rank in ranks.items()
                if places[m] == first
            }
            prefix = (prefix << (before - shift)) | (counts.shape[1] - 1 - first)
            if not shift:
                return prefix, ranks
            before, shift = shift, max(shift - NEXT_DIGIT, 0)
            counts = self._counted_within(prefix, before, shift)

    def _counted_within(self, prefix: int, before: int, shift: int) -> Int64[Tensor, "member digit"]:
        """Count samples without a bin whose norms begin with these digits by the digit after them."""
        counts = self._none_counted(shift, before)
        for rows in self._blocks():
            keys = self._keys[rows]
            inside = torch.nonzero((keys >> before == prefix) & (self.bins[rows] == self._open)).squeeze(1)
            if len(inside):
                digit = (keys[inside] >> shift) & (counts.shape[1] - 1)
                counts += self._count(self._preferred[rows][inside], digit, counts.shape[1])
        return counts

    def _assign_up_to(self, key: int, ranks: dict[int, int]) -> int:
        """Give all samples before the first without room to the members they prefer; return whose bin is full."""
        full, left = None, dict(ranks)
        given = torch.zeros(self._members, dtype=torch.int64)
        for rows in self._blocks():
            keys, bins, preferred = self._keys[rows], self.bins[rows], self._preferred[rows]
            free = bins == self._open
            taken = free & (keys > key)
            if full is None:
                equal = torch.nonzero(free & (keys == key)).squeeze(1)
                stop, full = _first_beyond(preferred[equal], left)
                taken[equal[:stop]] = True
                for member in left:
                    left[member] -= int((preferred[equal[:stop]] == member).sum())
            given += torch.bincount(preferred[taken], minlength=self._members).cpu()
            self.bins[rows] = torch.where(taken, preferred, bins)
        self._room -= given
        assert full is not None
        return full

    def _none_counted(self, shift: int, before: int) -> Int64[Tensor, "member digit"]:
        return torch.zeros(self._members, 1 << (before - shift), dtype=torch.int64)

    def _count(
        self, members: Shaped[Tensor, " sample"], digits: Shaped[Tensor, " sample"], size: int
    ) -> Int64[Tensor, "member digit"]:
        codes = members.to(torch.int32) * size + digits.to(torch.int32)
        return torch.bincount(codes, minlength=self._members * size).view(self._members, size).cpu()


def bins_dtype(members: int) -> torch.dtype:
    """Return the smallest type for bins of so many members, of which one value is left for what has none."""
    return torch.uint8 if members < 255 else torch.int32


def _first_beyond(preferred: Shaped[Tensor, " sample"], room: Mapping[int, int]) -> tuple[int, int | None]:
    """Return how many samples find room before the first that does not, and the bin that this one finds full."""
    stop, full = len(preferred), None
    for member, places in room.items():
        own = torch.nonzero(preferred == member).squeeze(1)
        if len(own) > places and int(own[places]) < stop:
            stop, full = int(own[places]), member
    return stop, full


def best_members(losses: Float[Tensor, "sample member"]) -> Shaped[Tensor, " sample"]:
    """Return the member with each sample's lowest loss (equal losses: the lower index), as small integers."""
    samples, members = losses.shape
    best = torch.empty(samples, dtype=bins_dtype(members), device=losses.device)
    for first in range(0, samples, ROWS_ON_CPU):
        rows = slice(first, first + ROWS_ON_CPU)
        best[rows] = losses[rows].argmin(dim=1).to(best.dtype)
    return best


def draw_bins(
    losses: Float[Tensor, "sample member"], temperature: float, generator: torch.Generator
) -> Shaped[Tensor, " sample"]:
    """Draw a member for each sample, the more often the lower its loss, so that every bin has about N/n samples.

    Sample i goes to member k with a probability in proportion to c[k] * losses[i, k]**(-1 / temperature). The c are
    such that these probabilities add up to N/n for every member (Sinkhorn). As the temperature falls to 0, every sample
    has one member left, as in the optimal assignment that Algorithm 1 comes near to.

    Args:
        losses: loss profile of each sample, in any unit, finite.
        temperature: above 0.
        generator: what draws.

    Raises:
        TrainingError: as in `assign_to_bins`.
    """
    _check_shape(losses)
    samples, members = losses.shape
    balance = torch.zeros(members, dtype=torch.float64, device=losses.device)

    def scores() -> Iterator[tuple[slice, Float[Tensor, "sample member"]]]:
        for first in range(0, samples, ROWS_ON_CPU):
            part = losses[first : first + ROWS_ON_CPU]
            _check_finite(part)
            log = part.double().clamp(min=torch.finfo(torch.float32).tiny).log()
            yield slice(first, first + ROWS_ON_CPU), log / -temperature + balance

    for _ in range(SINKHORN_ROUNDS if samples else 0):
        parts = [torch.logsumexp(torch.log_softmax(part, dim=1), dim=0) for _, part in scores()]
        balance += math.log(samples / members) - torch.logsumexp(torch.stack(parts), dim=0)
    drawn = torch.empty(samples, dtype=bins_dtype(members))
    for rows, part in scores():
        # Drawn on the CPU, whose generator it is.
        each = torch.multinomial(torch.softmax(part, dim=1).cpu(), 1, generator=generator)
        drawn[rows] = each.squeeze(1).to(drawn.dtype)
    return drawn.to(losses.device)


def _check_shape(losses: Float[Tensor, "sample member"]) -> None:
    if losses.ndim != 2 or losses.shape[1] == 0:
        message = f"losses should have shape (samples, members >= 1), but have shape {tuple(losses.shape)}"
        raise TrainingError(message)


def _check_finite(losses: Float[Tensor, "sample member"]) -> None:
    if not torch.isfinite(losses).all():
        message = "a loss profile has a value that is not finite: lower the learning rate or check the data"
        raise TrainingError(message)


def _room(samples: int, members: int, slack: float) -> Int64[Tensor, " member"]:
    """Return how many samples the bin of each member may take."""
    if slack:
        # The slack as it was written: 10 samples and 0.1 more are 11, which they are not in float64.
        return torch.full((members,), math.ceil((1 + Fraction(str(slack))) * samples / members), dtype=torch.int64)
    room = torch.full((members,), samples // members, dtype=torch.int64)
    room[: samples % members] += 1
    return room


def _lowest_open(columns: Float[Tensor, "member sample"], closed: Bool[Tensor, " member"]) -> Int32[Tensor, " sample"]:
    """Return the index of each sample's lowest loss among the members that are not closed; ties go to the lower."""
    first, *others = torch.nonzero(~closed).squeeze(1).tolist()
    # A running minimum over members: strict comparison keeps the lower index, and it is several times faster on a CPU
    # than argmin over a short dimension.
    lowest = columns[first]
    preferred = torch.full((len(lowest),), first, dtype=torch.int32, device=columns.device)
    for member in others:
        preferred.masked_fill_(columns[member] < lowest, member)
        lowest = torch.minimum(lowest, columns[member])
    return preferred
