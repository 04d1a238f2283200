"""Motion from wherever it is kept, a database or a folder of clips: one terrain patch, in the order of the source."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.sources.motion.clips import read_clips
from addressed_dynamics.sources.motion.contents import CycleRows, Survey, cycle_starts
from addressed_dynamics.sources.motion.database import Database, open_database
from addressed_dynamics.sources.motion.survey import BLOCK_ROWS, survey_clips, survey_database


def read_motion(path: Path | str) -> Motion:
    """Read the motion in a database (`.npz`) or in a folder of clips (`.bvh` with their side files), whole.

    Rows keep the order of the source. Copies of a cycle on other terrain are left out; what is kept is the first. A
    full database takes some 6 GB this way: `stream_motion` yields it in blocks.

    Raises:
        MotionError: nothing is there, or a file is damaged or of another layout.
    """
    path = Path(path)
    if path.is_dir():
        clips = list(read_clips(path))
        return join_motion(clips, sum(map(len, clips)))
    survey = survey_motion(path)
    return join_motion(stream_motion(path, survey), survey.kept_rows)


def survey_motion(path: Path | str) -> Survey:
    """Read a source of motion once, and find its clips and cycles, and what of it are only copies.

    Raises:
        MotionError: nothing is there, or a file is damaged or of another layout.
    """
    path = Path(path)
    return survey_clips(read_clips(path)) if path.is_dir() else survey_database(path)


def stream_motion(path: Path | str, survey: Survey | None = None, *, rows: int = BLOCK_ROWS) -> Iterator[Motion]:
    """Yield what `read_motion` returns in blocks of whole cycles.

    Args:
        path: a database or a folder of clips.
        survey: what `survey_motion` found in it; the source is surveyed first if it is not given.
        rows: the most rows in a block, if no cycle has more.

    Raises:
        MotionError: nothing is there, or a file is damaged or of another layout.
    """
    path = Path(path)
    if path.is_dir():
        yield from _stream_clips(read_clips(path), rows)
        return
    survey = survey or survey_motion(path)
    with open_database(path) as database:
        for cycles in _in_blocks(survey.cycles, rows):
            yield _read_cycles(database, cycles)
        database.skip(database.rows - database.row)  # to the end, where the checksums are


def join_motion(parts: Iterator[Motion] | Sequence[Motion], rows: int) -> Motion:
    """Put parts of `rows` rows in all one after the other, without a second copy of all of them at once."""
    x, y = np.empty((rows, INPUT.width), np.float32), np.empty((rows, OUTPUT.width), np.float32)
    phase, frame, cycle = np.empty(rows, np.float32), np.empty(rows, np.int64), np.empty(rows, np.int64)
    clips, start = [np.empty(0, "U1")], 0
    for part in parts:
        here = slice(start, start + len(part))
        x[here], y[here], phase[here], frame[here], cycle[here] = part.x, part.y, part.phase, part.frame, part.cycle
        clips.append(part.clip)
        start += len(part)
    return Motion(x, y, phase, np.concatenate(clips), frame, cycle)


def _stream_clips(clips: Iterator[Motion], rows: int) -> Iterator[Motion]:
    for motion in clips:
        starts = cycle_starts(motion).tolist()
        lengths = np.diff(starts, append=len(motion)).tolist()
        cycles = zip(starts, lengths, strict=True)
        places = [CycleRows(start, length, "", 0, 0) for start, length in cycles]
        for block in _in_blocks(places, rows):
            yield motion.select(slice(block[0].row, block[-1].row + block[-1].rows))


def _in_blocks(cycles: Sequence[CycleRows], rows: int) -> Iterator[list[CycleRows]]:
    block, size = list[CycleRows](), 0
    for cycle in cycles:
        if block and size + cycle.rows > rows:
            yield block
            block, size = [], 0
        block.append(cycle)
        size += cycle.rows
    if block:
        yield block


def _read_cycles(database: Database, cycles: Sequence[CycleRows]) -> Motion:
    rows = sum(cycle.rows for cycle in cycles)
    x, y = np.empty((rows, INPUT.width), np.float32), np.empty((rows, OUTPUT.width), np.float32)
    phase, stop = np.empty(rows, np.float32), 0
    for cycle in cycles:
        database.skip(cycle.row - database.row)
        block = database.read(cycle.rows)
        here = slice(stop, stop := stop + cycle.rows)
        x[here], y[here], phase[here] = block.x, block.y, block.phase
    lengths = [cycle.rows for cycle in cycles]
    return Motion(
        x,
        y,
        phase,
        clip=np.repeat([cycle.clip for cycle in cycles], lengths),
        frame=np.concatenate([np.arange(cycle.frame, cycle.frame + cycle.rows) for cycle in cycles]),
        cycle=np.repeat([cycle.cycle for cycle in cycles], lengths),
    )
