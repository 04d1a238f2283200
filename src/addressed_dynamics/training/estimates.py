"""How long a training will take, from a few updates of the same size on random samples."""

from __future__ import annotations

import heapq
import time
from collections.abc import Callable, Iterable, Iterator

import torch

from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.training.epochs import Epoch, updates_per_epoch

PROBE_UPDATES = 8
"""Updates that are timed, after as many to warm up."""


def seconds_per_update(
    training: Callable[[Samples], Iterator[Epoch]],
    *,
    inputs: int,
    outputs: int,
    members: int,
    batch_size: int,
    samples: int,
) -> float:
    """Return how long an update of `training` takes on this machine.

    Args:
        training: given samples, trains on them for two epochs.
        inputs: columns of their x.
        outputs: columns of their y.
        members: networks that an epoch's samples are divided among.
        batch_size: samples per member and update.
        samples: as many as there are; no more are made up.
    """
    rows = max(min(PROBE_UPDATES * members * batch_size, samples), members)
    generator = torch.Generator().manual_seed(0)
    probe = Samples(
        x=torch.randn(rows, inputs, generator=generator),
        y=torch.randn(rows, outputs, generator=generator),
        episode=torch.zeros(rows, dtype=torch.int64),
        step=torch.arange(rows),
    )
    ends = [time.perf_counter() for _ in training(probe)]
    return (ends[-1] - ends[0]) / max(updates_per_epoch(rows, members, batch_size), 1)


def all_done(durations: Iterable[float], processes: int) -> float:
    """Return when the last of some trainings ends, if each begins as soon as one of the processes is free."""
    free = [0.0] * processes
    for duration in durations:
        heapq.heapreplace(free, free[0] + duration)
    return max(free)


def in_words(seconds: float) -> str:
    """Return a duration as a person would say it, for instance `2 h 10 min`."""
    minutes = round(seconds / 60)
    if seconds < 60:
        return f"{max(round(seconds), 1)} s"
    if minutes < 60:
        return f"{minutes} min"
    hours, rest = divmod(round(minutes / 10) * 10 if minutes >= 120 else minutes, 60)
    return f"{hours} h {rest} min" if rest else f"{hours} h"
