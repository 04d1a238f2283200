"""Gait cycles of clips: where they lie in a source of motion, and what a survey of the source finds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int64

from addressed_dynamics.episodes.motion import Motion

MIRROR = "_mirror"
"""End of the name of a clip whose left and right are exchanged."""

Boundaries = Literal["meta", "phase", "files"]
"""How clips were told apart: by what the database says, by the phase alone, or by their files."""


@dataclass(frozen=True, slots=True)
class CycleRows:
    """Where a gait cycle lies in a source: in consecutive rows."""

    row: int
    """Its first row in the source, counting those that are not kept."""
    rows: int
    """Number of rows."""
    clip: str
    """Name of its clip; `clip_0000` … where the database does not name them."""
    cycle: int
    """Number in the clip."""
    frame: int
    """Frame of its first row in the clip, at 60 Hz."""


@dataclass(frozen=True)
class Survey:
    """What a source of motion holds, found by reading it once."""

    rows: int
    """Rows in the source."""
    cycles: tuple[CycleRows, ...]
    """The cycles that are kept, in the order of their rows: each once, on the first patch of terrain."""
    exact_duplicates: int
    """Rows that are equal, in every bit, to a row before them."""
    other_patches: int
    """Rows that are not kept because they repeat a kept one on other terrain."""
    boundaries: Boundaries
    """How clips were told apart."""
    groups: Mapping[str, str]
    """The group of each clip; clips that mirror each other, or show parts of one performance, are in one group.
    Their frames count alike: equal frames of two clips of a group are the same moment."""

    @property
    def kept_rows(self) -> int:
        """Number of rows that are kept."""
        return sum(cycle.rows for cycle in self.cycles)


def cycle_starts(motion: Motion) -> Int64[np.ndarray, " cycle"]:
    """Return the rows of `motion` where a cycle begins."""
    new = (motion.clip[1:] != motion.clip[:-1]) | (motion.cycle[1:] != motion.cycle[:-1])
    return np.flatnonzero(np.concatenate([[len(motion) > 0], new])[: len(motion)])


def mirror_groups(clips: Iterable[str]) -> dict[str, str]:
    """Return the group of each clip, where the name of a mirrored clip ends in `_mirror`."""
    return {clip: clip.removesuffix(MIRROR) for clip in clips}
