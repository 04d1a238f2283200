"""What several tests build: small logs, and disks that fill up."""

import errno
import io
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from strategies import random_transitions

from addressed_dynamics.episodes.transitions import COLUMNS, Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.logs import RunInfo, TransitionLogWriter

RUN = RunInfo(
    environment="Some-v0",
    kwargs={"difficulty": 3},
    segment="learning",
    behaviour="dqn",
    seed=4,
    versions={"numpy": "2.0"},
    git_commit="abc",
    started="2020-01-01T00:00:00+00:00",
)
CAR = SpaceSpec(
    observation=(Dimension("position", "m", -1.2, 0.6), Dimension("velocity", "m/step", -0.07, 0.07)),
    action=DiscreteAction(("push_left", "no_push", "push_right")),
    step_seconds=1 / 30,
)
WINDY = replace(
    CAR,
    exogenous=(Dimension("wind", "m/s", -20.0, 20.0), Dimension("slope", "", -np.inf, np.inf)),
)
"""The car's spaces with two exogenous inputs."""


def car_transitions(lengths: Sequence[int], seed: int = 0) -> Transitions:
    """Episodes of these lengths with random numbers in them, as if from a MountainCar."""
    return random_transitions(CAR, list(lengths), np.random.default_rng(seed))


def append_rows(writer: TransitionLogWriter, transitions: Transitions, rows: slice) -> None:
    """Append some transitions, which must be of one episode."""
    columns = [name for name in COLUMNS if name != "time_ns"]
    for row in range(rows.start, rows.stop):
        writer.append(**{name: getattr(transitions, name)[row] for name in columns})


def write_log(
    path: Path, transitions: Transitions, *, seeds: Sequence[int | None] | None = None, run: RunInfo = RUN
) -> Path:
    """Write a complete log of whole episodes."""
    with TransitionLogWriter(path, transitions.spec, run=run) as writer:
        for index, rows in enumerate(transitions.episode_slices()):
            append_rows(writer, transitions, rows)
            writer.end_episode(seeds[index] if seeds else None, cut=False)
    return path


def assert_same(found: Transitions, expected: Transitions) -> None:
    """Compare all columns bit for bit."""
    assert found.spec == expected.spec
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name, strict=True)


class FullDisk(io.FileIO):
    """A file on a disk that has room for so many bytes more."""

    def __init__(self, path: Path, room: int) -> None:
        super().__init__(path, "xb")
        self.room = room

    def write(self, data: bytes) -> int:
        if self.room <= 0:
            raise OSError(errno.ENOSPC, "No space left on device")
        written = super().write(memoryview(data)[: self.room])
        self.room -= written
        return written


def fill_disk_after(monkeypatch, room: int) -> None:
    """Let every new log find a disk with room for so many bytes."""
    original = Path.open

    def open_on_full_disk(path: Path, mode: str = "r", *args, **kwargs):
        if mode == "xb":
            return io.BufferedWriter(FullDisk(path, room))
        return original(path, mode, *args, **kwargs)

    monkeypatch.setattr(Path, "open", open_on_full_disk)
