"""Algorithm 1 of the paper: give every sample to one subnetwork, by loss, in equally large bins."""

import math
from fractions import Fraction

import torch
from jaxtyping import Bool, Float, Int32, Int64
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError

SINKHORN_ROUNDS = 30
"""Rounds in which drawn bins become equally large."""


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

    Args:
        losses: loss profile of each sample: its loss under each member, in any unit, finite.
        slack: share by which a bin may be larger than N/n.

    Returns:
        The member each sample is assigned to, in 0..n-1, on the device of `losses`.

    Raises:
        TrainingError: `losses` is not a matrix with at least one member, or holds a value that is not finite.
    """
    _check(losses)
    samples, members = losses.shape
    # What is left to assign, hardest first. Choices are made where the losses lie and only their labels are gathered in
    # this order: gathering the losses themselves costs more than the sort, unless few samples are left.
    left = torch.argsort(torch.linalg.vector_norm(losses, dim=1), descending=True, stable=True)
    columns, places = losses.T.contiguous(), left
    room = _room(samples, members, slack)
    closed = room == 0
    assigned = torch.empty(samples, dtype=torch.int64, device=losses.device)
    while len(left):
        if len(left) < columns.shape[1] // 4:
            columns, places = columns[:, places], torch.arange(len(left), device=losses.device)
        preferred = _lowest_open(columns, closed)[places]
        stop, full = _first_without_room(preferred, room, closed)
        assigned[left[:stop]] = preferred[:stop].long()
        room -= torch.bincount(preferred[:stop], minlength=members).cpu()
        left, places = left[stop:], places[stop:]
        if full is not None:
            closed[full] = True
    return assigned


def draw_bins(
    losses: Float[Tensor, "sample member"], temperature: float, generator: torch.Generator
) -> Int64[Tensor, " sample"]:
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
    _check(losses)
    samples, members = losses.shape
    scores = losses.double().clamp(min=torch.finfo(torch.float32).tiny).log() / -temperature
    balance = torch.zeros(members, dtype=torch.float64)
    for _ in range(SINKHORN_ROUNDS):
        taken = torch.logsumexp(torch.log_softmax(scores + balance, dim=1), dim=0)
        balance += math.log(samples / members) - taken
    return torch.multinomial(torch.softmax(scores + balance, dim=1), 1, generator=generator).squeeze(1)


def _check(losses: Float[Tensor, "sample member"]) -> None:
    if losses.ndim != 2 or losses.shape[1] == 0:
        message = f"losses should have shape (samples, members >= 1), but have shape {tuple(losses.shape)}"
        raise TrainingError(message)
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


def _first_without_room(
    preferred: Int32[Tensor, " sample"], room: Int64[Tensor, " member"], closed: Bool[Tensor, " member"]
) -> tuple[int, int | None]:
    """Return how many samples find room before the first that does not, and the bin that this one finds full."""
    stop, full = len(preferred), None
    counts = torch.bincount(preferred, minlength=len(room)).cpu()
    for member in torch.nonzero((counts > room) & ~closed).squeeze(1).tolist():
        overflow = int(torch.nonzero(preferred == member).squeeze(1)[room[member]])
        if overflow < stop:
            stop, full = overflow, member
    return stop, full
