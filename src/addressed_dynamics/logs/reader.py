"""Read a log of transitions, checking everything that can be checked."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from mcap.writer import MCAP0_MAGIC as MAGIC

from addressed_dynamics.base.errors import LogError, TransitionsError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.logs.container import Damage, MessageRun, Source, scan
from addressed_dynamics.logs.contents import EpisodeRecord, LogContents, RunRecord
from addressed_dynamics.logs.decoding import Columns, Found, episode_records, run_record, transition_columns
from addressed_dynamics.logs.log_file import CHUNK_BYTES
from addressed_dynamics.logs.schema import EPISODE_SCHEMA, TRANSITION_SCHEMA

COMPRESSED = {
    bytes.fromhex("28b52ffd"): "zstd -d",
    bytes.fromhex("1f8b"): "gunzip",
    bytes.fromhex("04224d18"): "lz4 -d",
}
"""What undoes the compression of a whole file, by how it begins."""

TOGETHER_BYTES = CHUNK_BYTES // 2
"""Chunks are decoded together until they have so many bytes: a recorder ends one with each episode, and to decode a
small one costs as much as a large one."""


def read_log(path: Path) -> LogContents:
    """Read the log at `path`.

    Raises:
        LogError: there is no such file, it is damaged anywhere, it was not finished, or it is not a log of
            transitions; the message says where, and what can be done.
    """
    blocks = list(_blocks(path))
    record = blocks[0][0]
    columns = {name: np.concatenate([block[name] for _, block, _ in blocks]) for name in blocks[0][1]}
    episodes = tuple(episode for _, _, ends in blocks for episode in ends)
    return LogContents(_transitions(path, record, columns), episodes, record.info, record.recording)


def read_blocks(path: Path) -> Iterator[LogContents]:
    """Yield the contents of the log at `path` chunk by chunk, small ones together, in the memory of a large one.

    There is at least one block, with no transitions if the log has none. An episode may go on in the next block; its
    record is in the block that it ends in.

    Raises:
        LogError: as `read_log`, when the place is reached; only a loop that goes to the end has checked the file.
    """
    before: Transitions | None = None
    for record, columns, episodes in _blocks(path):
        block = _transitions(path, record, columns)
        if before is not None and len(block):
            try:
                Transitions.concatenate([before, block.select(slice(0, 1))])
            except TransitionsError as error:
                message = f"{path}: {error}"
                raise LogError(message) from error
        before = block.select(slice(-1, None)) if len(block) else before
        yield LogContents(block, tuple(episodes), record.info, record.recording)


def read_episodes(path: Path, *, at_least: int) -> Iterator[LogContents]:
    """Yield the contents of the log at `path` in blocks of whole episodes.

    A block ends with the first episode in which it reaches `at_least` transitions; the last may be smaller. Memory is
    needed for one block and one chunk at a time. There is at least one block.

    Raises:
        LogError: as `read_blocks`.
    """
    parts, episodes, size, begun = list[Transitions](), list[EpisodeRecord](), 0, False
    for block in read_blocks(path):
        part = block.transitions
        parts.append(part)
        episodes += block.episodes
        size += len(part)
        if size >= at_least and block.episodes:
            # What follows the last end in this chunk belongs to an episode of the next block.
            last = np.flatnonzero(part.episode == block.episodes[-1].episode)[-1] + 1
            parts[-1] = part.select(slice(0, last))
            yield LogContents(Transitions.concatenate(parts), tuple(episodes), block.run, block.recording)
            parts, episodes, size, begun = [part.select(slice(last, None))], [], len(part) - last, True
    if size or not begun:
        yield LogContents(Transitions.concatenate(parts), tuple(episodes), block.run, block.recording)


def _blocks(path: Path) -> Iterator[tuple[RunRecord, Columns, list[EpisodeRecord]]]:
    """Yield the decoded contents of the chunks, small ones together, and check what only the whole file shows."""
    found, tally, read, waiting = Found(), _Tally(path), 0, 0
    record: RunRecord | None = None
    with open_source(path) as source:
        try:
            for content in scan(source):
                starts_chunk = (
                    isinstance(content, MessageRun) and found.runs and content.offset != found.runs[-1].offset
                )
                if starts_chunk and waiting >= TOGETHER_BYTES and (record or found.channels):
                    record = record or run_record(path, found)
                    yield tally.add(record, found)
                    read += found.intact
                    found.runs.clear()
                    waiting = 0
                found.add(content)
                waiting += content.messages.size if isinstance(content, MessageRun) else 0
        except Damage as damage:
            message = (
                f"{path}: byte {damage.offset} {damage.reason}; {read + found.intact} transitions before it are "
                f"intact: 'addressed-dynamics recover {path}' writes all that can be saved to a new file"
            )
            raise LogError(message) from damage
    yield tally.add(record or run_record(path, found), found)
    tally.check()


class _Tally:
    """Counts the transitions of each episode, to hold them against the records of the episodes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._found: list[tuple[int, int]] = []
        self._recorded: list[tuple[int, int]] = []

    def add(self, record: RunRecord, found: Found) -> tuple[RunRecord, Columns, list[EpisodeRecord]]:
        """Decode the messages in `found` and count them."""
        try:
            columns = transition_columns(record.spec, found.runs_of(TRANSITION_SCHEMA))
            episodes = list(episode_records(found.runs_of(EPISODE_SCHEMA)))
        except Damage as damage:
            reason = f"{damage.reason}; record it again, or ask the program that wrote it"
            message = f"{self._path}: byte {damage.offset} {reason}"
            raise LogError(message) from damage
        numbers = columns["episode"]
        bounds = np.flatnonzero(numbers[1:] != numbers[:-1]) + 1
        starts, stops = np.append(0, bounds), np.append(bounds, len(numbers))
        if len(numbers):
            for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
                self._count(int(numbers[start]), stop - start)
        self._recorded += [(each.episode, each.length) for each in episodes]
        return record, columns, episodes

    def _count(self, episode: int, length: int) -> None:
        if self._found and self._found[-1][0] == episode:
            length += self._found.pop()[1]
        self._found.append((episode, length))

    def check(self) -> None:
        """Refuse a log whose episodes are not those that it has records of."""
        hint = f"'addressed-dynamics recover {self._path}' writes what fits to a new file"
        for (episode, length), (expected, recorded) in zip(self._found, self._recorded, strict=False):
            if (episode, length) != (expected, recorded):
                message = (
                    f"{self._path}: episode {expected} should have {recorded} transitions, but episode {episode} with "
                    f"{length} was found in its place; {hint}"
                )
                raise LogError(message)
        if len(self._found) != len(self._recorded):
            message = (
                f"{self._path}: there are transitions of {len(self._found)} episodes, but records of "
                f"{len(self._recorded)}; {hint}"
            )
            raise LogError(message)


@contextmanager
def open_source(path: Path) -> Iterator[Source]:
    """Open an MCAP file for reading.

    Raises:
        LogError: it cannot be read, is empty, or does not begin as an MCAP file does.
    """
    try:
        with path.open("rb") as file:
            source = Source(file)
            _check_signature(path, source)
            yield source
    except FileNotFoundError as error:
        partial = path.with_name(f"{path.name}.partial")
        hint = f"; an unfinished one is there: 'addressed-dynamics recover {partial}'" if partial.exists() else ""
        message = f"{path}: there is no such log{hint}"
        raise LogError(message) from error
    except OSError as error:
        message = f"{path}: the log cannot be read ({error.strerror})"
        raise LogError(message) from error


def refuse_compressed(path: Path, source: Source) -> None:
    """Do nothing unless the file as a whole is compressed.

    Raises:
        LogError: it is; the message says what undoes it.
    """
    for magic, undo in COMPRESSED.items():
        if source.read(0, len(magic)) == magic:
            message = f"{path}: this is a compressed file, not an MCAP log; undo it with '{undo} {path.name}'"
            raise LogError(message)


def _check_signature(path: Path, source: Source) -> None:
    if not source.size:
        message = f"{path}: the file is empty (0 bytes), but an MCAP log was expected; record it again"
        raise LogError(message)
    refuse_compressed(path, source)
    if (start := source.read(0, len(MAGIC))) != MAGIC:
        message = f"{path}: byte 0 should begin an MCAP log, but the file begins with {start!r}; give an .mcap file"
        raise LogError(message)


def _transitions(path: Path, record: RunRecord, columns: Columns) -> Transitions:
    try:
        return Transitions(record.spec, **columns)
    except TransitionsError as error:
        message = f"{path}: {error}"
        raise LogError(message) from error
