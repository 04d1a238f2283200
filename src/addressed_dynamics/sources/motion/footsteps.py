"""Gait cycles of a clip: from one footstep to the next of the same foot."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Int64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import OFFSETS

REACH = -OFFSETS[0]
"""Frames that a cycle needs before its first frame, for the trajectory that was, and one more than it needs after."""


@dataclass(frozen=True)
class Cycle:
    """A gait cycle."""

    index: int
    """Number of the cycle in the clip, from 0; cycles that are left out count."""
    first: int
    """Its first frame, at 60 Hz."""
    last: int
    """Its last frame, which is the first of the next cycle."""


@dataclass(frozen=True)
class Rows:
    """The frames of several cycles, one row a frame."""

    frame: Int64[np.ndarray, " row"]
    """Frame in the clip, at 60 Hz."""
    cycle: Int64[np.ndarray, " row"]
    """Number of its cycle in the clip."""
    first: Bool[np.ndarray, " row"]
    """Whether it is the first frame of its cycle."""
    last: Bool[np.ndarray, " row"]
    """Whether it is the last."""


def parse_cycles(path: Path, lines: list[str], step: int) -> list[Cycle]:
    """Return the cycles that a `_footsteps.txt` file describes, without those that it leaves out.

    A line holds two frame numbers; a cycle goes from the first number of a line to the first of the next one. It is
    left out where one of the two lines ends in `*` or is blank, or where the second has one number only, as it stands
    at the end of some files.

    Args:
        path: the file, for errors.
        lines: its lines.
        step: frames of the clip to one at 60 Hz; the file counts frames of the clip.

    Raises:
        MotionError: a line begins with something else than a number, or numbers do not ascend.
    """
    cycles = []
    for index, (line, following) in enumerate(pairwise(lines)):
        words, next_words = line.split(), following.split()
        marked = any(each and each[-1].endswith("*") for each in (words, next_words))
        if marked or not words or len(next_words) < 2:
            continue
        first, last = _number(path, index + 1, words[0]) // step, _number(path, index + 2, next_words[0]) // step
        if first >= last:
            message = f"{path}, line {index + 2}: expected a frame after {words[0]}, but found {next_words[0]}"
            raise MotionError(message)
        cycles.append(Cycle(index, first, last))
    return cycles


def within(cycles: list[Cycle], frames: int) -> list[Cycle]:
    """Return the cycles around which a clip of `frames` frames has all that inputs and outputs look at."""
    return [cycle for cycle in cycles if cycle.first >= REACH and cycle.last < frames - REACH - 1]


def rows_of(cycles: list[Cycle]) -> Rows:
    """Return all frames of `cycles`, both ends included."""
    lengths = [cycle.last + 1 - cycle.first for cycle in cycles]
    ends = np.cumsum(lengths, dtype=np.int64)
    frame = np.concatenate([np.empty(0, np.int64), *(np.arange(each.first, each.last + 1) for each in cycles)])
    row = np.arange(len(frame))
    return Rows(
        frame=frame,
        cycle=np.repeat(np.array([cycle.index for cycle in cycles], np.int64), lengths),
        first=np.isin(row, ends - lengths),
        last=np.isin(row, ends - 1),
    )


def _number(path: Path, line: int, word: str) -> int:
    try:
        return int(word)
    except ValueError:
        message = f"{path}, line {line}: expected the number of a frame, but found '{word[:40]}'"
        raise MotionError(message) from None
