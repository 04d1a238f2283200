"""Algorithm 1 of the paper: give every sample to one subnetwork, by loss, in equally large bins."""

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.errors import TrainingError


def assign_to_bins(losses: Float[Tensor, "sample member"]) -> Int64[Tensor, " sample"]:
    """Assign each sample to a member so that all bins hold N/n samples (the paper, Section 2, Algorithm 1).

    Samples are taken in descending L2 norm of their loss profile (equal norms: in the order given). Each goes to its
    lowest-loss member whose bin has room (equal losses: to the lower index). The paper is silent about an N that n
    does not divide: here the first N mod n members take one sample more, and none is dropped. The printed listing
    loops `while len(Ls) < 0`; it means: until the list is empty.

    Works in at most n phases instead of N steps: as long as no bin fills up, every remaining sample's choice is known
    at once. A phase ends at the first sample that finds its bin full; that bin is closed, and the rest choose again.

    Args:
        losses: loss profile of each sample: its loss under each member, in any unit, finite.

    Returns:
        The member each sample is assigned to, in 0..n-1, on the device of `losses`.

    Raises:
        TrainingError: `losses` is not a matrix with at least one member, or holds a value that is not finite.
    """
    if losses.ndim != 2 or losses.shape[1] == 0:
        message = f"losses should have shape (samples, members >= 1), but have shape {tuple(losses.shape)}"
        raise TrainingError(message)
    if not torch.isfinite(losses).all():
        message = "a loss profile has a value that is not finite: lower the learning rate or check the data"
        raise TrainingError(message)
    samples, members = losses.shape
    hardest_first = torch.argsort(torch.linalg.vector_norm(losses, dim=1), descending=True, stable=True)
    ordered = losses[hardest_first]
    room = torch.full((members,), samples // members, dtype=torch.int64)
    room[: samples % members] += 1
    closed = room == 0
    assigned = torch.empty(samples, dtype=torch.int64, device=losses.device)
    done = 0
    while done < samples:
        preferred = _lowest_open(ordered[done:], closed)
        stop, full = _first_without_room(preferred, room, closed)
        assigned[done : done + stop] = preferred[:stop]
        room -= torch.bincount(preferred[:stop], minlength=members).cpu()
        done += stop
        if full is not None:
            closed[full] = True
    members_of_samples = torch.empty_like(assigned)
    members_of_samples[hardest_first] = assigned
    return members_of_samples


def _lowest_open(losses: Float[Tensor, "sample member"], closed: Tensor) -> Int64[Tensor, " sample"]:
    """Return the index of each sample's lowest loss among the members that are not closed; ties go to the lower."""
    open_members = torch.nonzero(~closed).squeeze(1).to(losses.device)
    if len(open_members) == 1:
        return open_members.expand(len(losses))
    # A running minimum over columns: strict comparison keeps the lower index, and it is several times faster on a CPU
    # than argmin over a short last dimension.
    lowest = losses[:, open_members[0]]
    preferred = open_members[0].expand(len(losses))
    for member in open_members[1:]:
        better = losses[:, member] < lowest
        lowest = torch.where(better, losses[:, member], lowest)
        preferred = torch.where(better, member, preferred)
    return preferred


def _first_without_room(preferred: Int64[Tensor, " sample"], room: Tensor, closed: Tensor) -> tuple[int, int | None]:
    """Return how many samples find room before the first that does not, and the bin that this one finds full."""
    stop, full = len(preferred), None
    counts = torch.bincount(preferred, minlength=len(room)).cpu()
    for member in torch.nonzero((counts > room) & ~closed).squeeze(1).tolist():
        overflow = int(torch.nonzero(preferred == member).squeeze(1)[room[member]])
        if overflow < stop:
            stop, full = overflow, member
    return stop, full
