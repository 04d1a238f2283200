"""Algorithm 1 on a million samples against the naive loop and against one sort of a million floats."""

import time

import torch
from rounds import fastest

from addressed_dynamics.training.clustering import assign_to_bins

SAMPLES = 1_000_000


def naive(losses: torch.Tensor) -> torch.Tensor:
    """Transcribe Algorithm 1: samples in descending norm, each to its lowest loss whose bin has room."""
    samples, members = losses.shape
    room = [samples // members + (member < samples % members) for member in range(members)]
    order = torch.argsort(torch.linalg.vector_norm(losses, dim=1), descending=True, stable=True).tolist()
    rows = losses.tolist()
    assigned = [0] * samples
    for sample in order:
        row = rows[sample]
        for member in sorted(range(members), key=row.__getitem__):
            if room[member]:
                room[member] -= 1
                assigned[sample] = member
                break
    return torch.tensor(assigned)


def main() -> None:
    """Print one line for each shape and kind of profile."""
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    floats = torch.rand(SAMPLES, generator=generator)
    print(f"{'losses':>24}  {'seconds':>8}  {'of a sort':>9}  {'naive loop':>12}  equal")
    for members in (2, 8):
        even = torch.rand(SAMPLES, members, generator=generator)
        uneven = even * torch.tensor([0.1] + [1.0] * (members - 1))
        for kind, losses in (("even", even), ("one member wins", uneven)):
            best = fastest({"bins": lambda x=losses: assign_to_bins(x), "sort": lambda: torch.sort(floats)}, rounds=7)
            start = time.perf_counter()
            expected = naive(losses)
            loop = time.perf_counter() - start
            equal = torch.equal(expected, assign_to_bins(losses))
            ratios = f"{best['bins'] / best['sort']:8.2f}x  {loop / best['bins']:8.0f}x up"
            print(f"{f'1M x {members}, {kind}':>24}  {best['bins']:8.3f}  {ratios}  {equal}")


if __name__ == "__main__":
    main()
