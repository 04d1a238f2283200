"""How all benchmarks measure: what is compared takes turns in one run, and the rounds are summed up robustly."""

import resource
import statistics
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field


@dataclass
class Readings:
    """Seconds per call in every round."""

    wall: list[float] = field(default_factory=list)
    """By the clock on the wall."""
    cpu: list[float] = field(default_factory=list)
    """Spent by this process, in all of its threads."""


def take_turns(contestants: Mapping[str, Callable[[], object]], *, rounds: int, calls: int = 1) -> dict[str, Readings]:
    """Measure all contestants, who run one after the other in every round.

    So whatever slows the machine down for a while slows down all of them. A first round, which warms up caches and
    allocators, is not counted.
    """
    readings = {name: Readings() for name in contestants}
    for counted in [False, *[True] * rounds]:
        for name, call in contestants.items():
            wall, cpu = time.perf_counter(), time.process_time()
            for _ in range(calls):
                call()
            wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
            if counted:
                readings[name].wall.append(wall / calls)
                readings[name].cpu.append(cpu / calls)
    return readings


def median_ratio(above: Sequence[float], below: Sequence[float]) -> float:
    """Return the median over the rounds of the ratio within a round."""
    return statistics.median(a / b for a, b in zip(above, below, strict=True))


def peak_mib(who: int = resource.RUSAGE_SELF) -> float:
    """Return the largest resident memory so far of this process, or of any of its children (`RUSAGE_CHILDREN`)."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(who).ru_maxrss * unit / 2**20


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print rows below headings, the first column to the left and the others to the right."""
    widths = [max(map(len, column)) for column in zip(headings, *rows, strict=True)]
    for row in (headings, ["-" * width for width in widths], *rows):
        first, *others = zip(row, widths, strict=True)
        print("  ".join([first[0].ljust(first[1]), *(cell.rjust(width) for cell, width in others)]).rstrip())
