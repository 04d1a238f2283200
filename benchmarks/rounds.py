"""Take turns and keep the fastest round of each: what all the benchmarks share."""

import time
from collections.abc import Callable, Mapping


def fastest(contestants: Mapping[str, Callable[[], object]], *, rounds: int, repeats: int = 1) -> dict[str, float]:
    """Return the seconds of one call of each contestant, in its fastest round; the contestants take turns."""
    best = dict.fromkeys(contestants, float("inf"))
    for _ in range(rounds):
        for name, call in contestants.items():
            start = time.perf_counter()
            for _ in range(repeats):
                call()
            best[name] = min(best[name], (time.perf_counter() - start) / repeats)
    return best
