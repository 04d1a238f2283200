"""Surveys of motion: which rows are which cycle of which clip, and which are only copies of others.

A database writes each cycle once for every patch of terrain that fits it; ten times for flat clips, which makes ten
equal copies. One of them is kept. Splitting copies between training and test would let a model pass by memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from hashlib import blake2b
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Int64, UInt64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.contents import Boundaries, CycleRows, Survey, cycle_starts, mirror_groups
from addressed_dynamics.sources.motion.database import META_COLUMNS, Block, open_database
from addressed_dynamics.sources.motion.fingerprints import motion_fingerprints, phase_fingerprints, terrain_fingerprints
from addressed_dynamics.sources.motion.mirrors import align_mirrors

BLOCK_ROWS = 2**13
"""Rows that are in memory at once."""
MAX_CYCLE_ROWS = 2**16
"""A cycle of more rows, eighteen minutes, is none: the phase never came back to 0."""
HIPS_RISE = OUTPUT.names.index("joint_velocity.Hips.y")
FRAME = META_COLUMNS.index("frame")
COPY = [column for column in range(len(META_COLUMNS)) if column != FRAME]
"""Columns of `meta` that tell one copy of a cycle from another."""


@dataclass(frozen=True)
class _RowFacts:
    """What is kept of every row of a database while it is surveyed: some 30 bytes."""

    starts: Bool[np.ndarray, " row"]
    """Whether a copy of a cycle begins here."""
    motion: UInt64[np.ndarray, " row"]
    """Fingerprint of the row without its phase and its terrain."""
    cyclic: UInt64[np.ndarray, " row"]
    """Fingerprint of the row without its terrain."""
    whole: UInt64[np.ndarray, " row"]
    """Fingerprint of the row."""
    hips_rise: Float32[np.ndarray, " row"]
    """Vertical velocity of the hips: the same in a mirror."""
    meta: Int64[np.ndarray, "start 4"]
    """What the database says of the rows where a copy of a cycle begins; no rows if it says nothing."""

    @staticmethod
    def join(parts: Sequence[_RowFacts]) -> _RowFacts:
        """Put the facts of consecutive blocks together."""
        return _RowFacts(
            *(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(_RowFacts))
        )


def survey_database(path: Path) -> Survey:
    """Read the database `path` once and find its clips, cycles and copies.

    Without `meta`, a cycle begins where the phase falls from 1 to 0, or falls and the joints do not go on from the row
    before. It repeats the cycle before it if all its rows do, but for what terrain changes; it belongs to the same
    clip if it begins with the frame that ended that one. So footsteps that were left out part a clip in two.

    Raises:
        MotionError: the database is damaged, or its cycles make no sense.
    """
    facts, names = _read_facts(path)
    starts = np.flatnonzero(facts.starts)
    lengths = np.diff(starts, append=len(facts.starts))
    if lengths.max() > MAX_CYCLE_ROWS:
        first, rows = int(starts[lengths.argmax()]), int(lengths.max())
        message = (
            f"{path}: rows {first} to {first + rows - 1} are one gait cycle of {rows:,} rows; expected the phase to "
            "fall from 1 to 0 after each cycle, with the rows of a clip in their order"
        )
        raise MotionError(message)
    places = list(zip(starts.tolist(), lengths.tolist(), strict=True))
    copies = _cycles_by_phase(facts, places) if names is None else _cycles_by_meta(facts, places, names)
    kept = tuple(_without_copies(facts, copies))
    if names is None:
        kept, groups = align_mirrors(kept, facts.hips_rise)
        return _survey(facts.whole, kept, "phase", groups)
    return _survey(facts.whole, kept, "meta", mirror_groups(cycle.clip for cycle in kept))


def survey_clips(clips: Iterable[Motion]) -> Survey:
    """Find the cycles of `clips`, whose rows are of one terrain patch each; all are kept."""
    cycles, whole, rows = list[CycleRows](), [np.empty(0, np.uint64)], 0
    for motion in clips:
        starts = cycle_starts(motion)
        # A clip none of whose cycles can be used has no rows.
        for start, stop in zip(starts.tolist(), np.append(starts, len(motion))[1:].tolist(), strict=True):
            place = (str(motion.clip[start]), int(motion.cycle[start]), int(motion.frame[start]))
            cycles.append(CycleRows(rows + start, stop - start, *place))
        terrain = terrain_fingerprints(motion.x, motion.y)
        whole.append(motion_fingerprints(motion.x, motion.y) ^ phase_fingerprints(motion.phase) ^ terrain)
        rows += len(motion)
    return _survey(np.concatenate(whole), tuple(cycles), "files", mirror_groups(cycle.clip for cycle in cycles))


def _read_facts(path: Path) -> tuple[_RowFacts, tuple[str, ...] | None]:
    parts, previous = list[_RowFacts](), None
    with open_database(path) as database:
        while database.row < database.rows:
            row = database.row
            block = database.read(BLOCK_ROWS)
            parts.append(_row_facts(path, previous, block, row))
            previous = block.last()
        return _RowFacts.join(parts), database.clips


def _row_facts(path: Path, previous: Block | None, block: Block, row: int) -> _RowFacts:
    motion = motion_fingerprints(block.x, block.y)
    cyclic = motion ^ phase_fingerprints(block.phase)
    starts = _starts_by_phase(previous, block)
    if block.meta is not None:
        starts = _starts_by_meta(path, previous, block.meta, row)
    return _RowFacts(
        starts=starts,
        motion=motion,
        cyclic=cyclic,
        whole=cyclic ^ terrain_fingerprints(block.x, block.y),
        hips_rise=block.y[:, HIPS_RISE].copy(),
        meta=np.empty((0, len(META_COLUMNS)), np.int64) if block.meta is None else block.meta[starts],
    )


def _starts_by_phase(previous: Block | None, block: Block) -> Bool[np.ndarray, " row"]:
    """Mark the rows that begin a copy of a cycle."""
    last = previous or block
    phase = np.concatenate([last.phase[-1:], block.phase[:-1]])
    velocity = np.concatenate([last.y[-1:, OUTPUT.joint_velocity], block.y[:-1, OUTPUT.joint_velocity]])
    goes_on = (velocity == block.x[:, INPUT.joint_velocity]).all(axis=1)
    starts: Bool[np.ndarray, " row"] = ((phase == 1) & (block.phase == 0)) | ((block.phase < phase) & ~goes_on)
    starts[0] |= previous is None
    return starts


def _starts_by_meta(
    path: Path, previous: Block | None, meta: Int64[np.ndarray, "row 4"], row: int
) -> Bool[np.ndarray, " row"]:
    """Mark the rows that begin a copy of a cycle; `row` is the first row of `meta` in the database."""
    last = meta[:1] if previous is None or previous.meta is None else previous.meta
    before = np.concatenate([last, meta[:-1]])
    starts: Bool[np.ndarray, " row"] = (meta[:, COPY] != before[:, COPY]).any(axis=1)
    starts[0] |= previous is None
    skips = ~starts & (meta[:, FRAME] != before[:, FRAME] + 1)
    if skips.any():
        message = (
            f"{path}: meta: row {row + int(skips.argmax())}: expected the frame after that of the row before it, as "
            "both are of one cycle and patch; keep the rows of a cycle together and in order"
        )
        raise MotionError(message)
    return starts


def _cycles_by_phase(facts: _RowFacts, places: Sequence[tuple[int, int]]) -> Iterator[CycleRows]:
    """Yield every copy of a cycle."""
    clip, cycle, frame, start, rows = -1, 0, 0, 0, 0
    for next_start, next_rows in places:
        old, new = slice(start, start + rows), slice(next_start, next_start + next_rows)
        if not np.array_equal(facts.cyclic[old], facts.cyclic[new]):
            if rows and facts.motion[next_start] == facts.motion[start + rows - 1]:
                cycle, frame = cycle + 1, frame + rows - 1
            else:
                clip, cycle, frame = clip + 1, 0, 0
        start, rows = next_start, next_rows
        yield CycleRows(start, rows, f"clip_{clip:04d}", cycle, frame)


def _cycles_by_meta(facts: _RowFacts, places: Sequence[tuple[int, int]], names: Sequence[str]) -> Iterator[CycleRows]:
    """Yield every copy of a cycle."""
    for (start, rows), (clip, frame, cycle, _) in zip(places, facts.meta.tolist(), strict=True):
        yield CycleRows(start, rows, names[clip], cycle, frame)


def _without_copies(facts: _RowFacts, cycles: Iterable[CycleRows]) -> Iterator[CycleRows]:
    """Yield each cycle the first time that it occurs, be it under another name."""
    named, seen = set[tuple[str, int]](), set[bytes]()
    for cycle in cycles:
        name = (cycle.clip, cycle.cycle)
        digest = blake2b(facts.cyclic[cycle.row : cycle.row + cycle.rows].tobytes(), digest_size=16).digest()
        if name not in named and digest not in seen:
            yield cycle
        named.add(name)
        seen.add(digest)


def _survey(
    whole: UInt64[np.ndarray, " row"], kept: tuple[CycleRows, ...], boundaries: Boundaries, groups: dict[str, str]
) -> Survey:
    is_kept = np.zeros(len(whole), dtype=bool)
    for cycle in kept:
        is_kept[cycle.row : cycle.row + cycle.rows] = True
    duplicates = len(whole) - len(np.unique(whole))
    dropped_duplicates = duplicates - (int(is_kept.sum()) - len(np.unique(whole[is_kept])))
    return Survey(
        rows=len(whole),
        cycles=kept,
        exact_duplicates=duplicates,
        other_patches=int((~is_kept).sum()) - dropped_duplicates,
        boundaries=boundaries,
        groups=groups,
    )
