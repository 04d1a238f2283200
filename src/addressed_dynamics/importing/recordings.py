"""Which files are one recording: those that recorders split, each of which begins where another one ends."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC as MAGIC

from addressed_dynamics.importing.ros_databases import is_database, times_in
from addressed_dynamics.logs.container import Damage, Source, frames

Recording = tuple[Path, ...]
"""Files in the order of their times."""


def recordings(files: Sequence[Recording], longest_ns: int) -> list[Recording]:
    """Join files that follow each other.

    Args:
        files: MCAP logs and databases of ROS 2, in any order; those that are known to be one recording stand together.
        longest_ns: the longest time between the end of a file and the start of the next of the same recording.

    Returns:
        The recordings in the order of their first message; files in which no time can be read come last, each by
        itself, for whoever reads them to say what is wrong.
    """
    spans = {each: _span(each) for each in files}
    timed = sorted((span, each) for each, span in spans.items() if span is not None)
    found: list[Recording] = []
    last: int | None = None
    for (start, end), each in timed:
        if last is not None and 0 <= start - last <= longest_ns:
            found[-1] += each
        else:
            found.append(each)
        last = end
    return [*found, *(each for each, span in spans.items() if span is None)]


def _span(files: Recording) -> tuple[int, int] | None:
    """Return the first and the last log time in some files; None if there is none, or one is damaged."""
    spans = [times_in(path) if is_database(path) else _mcap_span(path) for path in files]
    known = [span for span in spans if span is not None]
    if len(known) < len(spans):
        return None
    return min(start for start, _ in known), max(end for _, end in known)


def _mcap_span(path: Path) -> tuple[int, int] | None:
    """Return the first and the last log time in a file; None if there is none, or it is damaged."""
    first, last = 2**64, -1
    try:
        with path.open("rb") as file:
            for frame in frames(Source(file), len(MAGIC)):
                # A chunk begins with the times of its first and last message; in a message it follows two numbers.
                offset, until = {Opcode.CHUNK: (0, 16), Opcode.MESSAGE: (6, 14)}.get(Opcode(frame.opcode), (0, 0))
                times = [int.from_bytes(frame.body[at : at + 8], "little") for at in range(offset, until, 8)]
                if any(times):
                    first, last = min(first, times[0]), max(last, times[-1])
                if frame.opcode == Opcode.DATA_END:
                    break
    except (Damage, OSError, ValueError):
        return None
    return (first, last) if last >= 0 else None
