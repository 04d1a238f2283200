"""Algorithm 1 on a million loss profiles, against the naive loop and against one sort of a million numbers."""

import time

import torch
from measuring import median_ratio, print_table, take_turns
from torch import Tensor

from addressed_dynamics import assign_to_bins

SAMPLES = 1_000_000
ROUNDS = 5


def assign_one_by_one(losses: Tensor) -> Tensor:
    """Transcribe Algorithm 1 as the paper prints it, on plain lists, which are faster one by one than tensors."""
    samples, members = losses.shape
    room = [samples // members + (member < samples % members) for member in range(members)]
    norms, profiles = torch.linalg.vector_norm(losses, dim=1).tolist(), losses.tolist()
    assigned = [-1] * samples
    for sample in sorted(range(samples), key=lambda s: -norms[s]):
        for member in sorted(range(members), key=profiles[sample].__getitem__):
            if room[member]:
                room[member] -= 1
                assigned[sample] = member
                break
    return torch.tensor(assigned)


def profiles(members: int, kind: str) -> Tensor:
    """Return loss profiles: of members that are all alike, or with one that wins nearly every sample."""
    losses = torch.rand(SAMPLES, members, generator=torch.Generator().manual_seed(0)) ** 4
    if kind == "one wins":
        losses[:, 0] *= 1e-3
    return losses


def main() -> None:
    """Print the time of each, and the ratios."""
    torch.set_num_threads(1)
    numbers = torch.rand(SAMPLES, generator=torch.Generator().manual_seed(1))
    rows = []
    for members in (2, 8):
        for kind in ("random", "one wins"):
            losses = profiles(members, kind)
            start = time.perf_counter()
            expected = assign_one_by_one(losses)
            naive = time.perf_counter() - start
            equal = torch.equal(assign_to_bins(losses), expected)
            seconds = take_turns(
                {"ours": lambda losses=losses: assign_to_bins(losses), "sort": lambda: torch.sort(numbers)},
                rounds=ROUNDS,
            )
            ours = min(seconds["ours"].wall)
            ratio = median_ratio(seconds["ours"].wall, seconds["sort"].wall)
            rows.append([
                f"{SAMPLES:,} x {members}, {kind}", f"{1e3 * ours:.0f} ms", f"{naive / ours:.0f}x faster",
                "yes" if equal else "NO", f"{ratio:.1f}x (target: 4)",
            ])  # fmt: skip
    print_table(["profiles", "ours", "than the naive loop", "same bins", "of one sort"], rows)


if __name__ == "__main__":
    main()
