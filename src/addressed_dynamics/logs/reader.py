"""Read a log of transitions, checking everything that can be checked."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Shaped
from mcap.records import Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from addressed_dynamics.errors import LogError, TransitionsError
from addressed_dynamics.logs.container import MESSAGE_HEADER, Content, Damage, MessageRun, Source, scan
from addressed_dynamics.logs.contents import EpisodeRecord, LogContents, RunRecord
from addressed_dynamics.logs.layout import MessageLayout
from addressed_dynamics.logs.log_file import RUN_RECORD
from addressed_dynamics.logs.schema import (
    ENDED,
    EPISODE_SCHEMA,
    TRANSITION_SCHEMA,
    UNKNOWN_SEED,
    episode_layout,
    transition_layout,
)
from addressed_dynamics.transitions import DiscreteAction, SpaceSpec, Transitions

Columns = dict[str, Shaped[np.ndarray, "step ..."]]
"""The columns of `Transitions` by name."""


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
    return LogContents(_transitions(path, record, columns), episodes, record.info)


def read_blocks(path: Path) -> Iterator[LogContents]:
    """Yield the contents of the log at `path` chunk by chunk; memory is needed for one chunk at a time.

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
        yield LogContents(block, tuple(episodes), record.info)


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
            yield LogContents(Transitions.concatenate(parts), tuple(episodes), block.run)
            parts, episodes, size, begun = [part.select(slice(last, None))], [], len(part) - last, True
    if size or not begun:
        yield LogContents(Transitions.concatenate(parts), tuple(episodes), block.run)


def _blocks(path: Path) -> Iterator[tuple[RunRecord, Columns, list[EpisodeRecord]]]:
    """Yield the decoded contents of each chunk, and check what only the whole file shows."""
    found, tally, read = Found(), _Tally(path), 0
    record: RunRecord | None = None
    with open_source(path) as source:
        try:
            for content in scan(source):
                starts_chunk = isinstance(content, MessageRun) and found.runs and content.offset != found.runs[0].offset
                if starts_chunk and (record or found.channels):
                    record = record or run_record(path, found)
                    yield tally.add(record, found)
                    read += found.intact
                    found.runs.clear()
                found.add(content)
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


def _check_signature(path: Path, source: Source) -> None:
    if not source.size:
        message = f"{path}: the file is empty (0 bytes), but an MCAP log was expected; record it again"
        raise LogError(message)
    if (start := source.read(0, len(MAGIC))) != MAGIC:
        message = f"{path}: byte 0 should begin an MCAP log, but the file begins with {start!r}; give an .mcap file"
        raise LogError(message)


@dataclass
class Found:
    """What has been found in a file so far."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: list[Metadata] = field(default_factory=list)
    runs: list[MessageRun] = field(default_factory=list)

    def add(self, content: Content) -> None:
        """Take up one more thing."""
        match content:
            case Schema():
                self.schemas[content.id] = content
            case Channel():
                self.channels[content.id] = content
            case Metadata():
                self.metadata.append(content)
            case MessageRun():
                self.runs.append(content)

    def channels_of(self, schema: str) -> list[Channel]:
        """Return the channels whose messages have this schema."""
        ids = {each.id for each in self.schemas.values() if each.name == schema}
        return [channel for channel in self.channels.values() if channel.schema_id in ids]

    def runs_of(self, schema: str) -> list[MessageRun]:
        """Return the messages that have this schema, in the order of the file."""
        ids = {channel.id for channel in self.channels_of(schema)}
        return [run for run in self.runs if run.channel in ids]

    @property
    def intact(self) -> int:
        """Number of transitions found so far."""
        return sum(len(run) for run in self.runs_of(TRANSITION_SCHEMA))


def run_record(path: Path, found: Found) -> RunRecord:
    """Return the run record of a log that has one topic of transitions.

    Raises:
        LogError: there is no run record, or no topic or more than one.
    """
    channels = found.channels_of(TRANSITION_SCHEMA)
    if len(channels) != 1:
        names = {schema.id: schema.name for schema in found.schemas.values()}
        topics = ", ".join(
            f"{channel.topic} ({names.get(channel.schema_id) or channel.message_encoding})"
            for channel in found.channels.values()
        )
        message = (
            f"{path}: one topic with the schema {TRANSITION_SCHEMA} was expected, but the file has "
            f"{topics or 'no topics'}; give a log that TransitionRecorder wrote"
        )
        raise LogError(message)
    problem = f"it has no metadata record '{RUN_RECORD}'"
    # The channel carries a copy, which has survived if the record itself has not.
    candidates = [each.metadata for each in found.metadata if each.name == RUN_RECORD]
    for metadata in filter(None, [*candidates, channels[0].metadata]):
        try:
            return RunRecord.from_metadata(metadata)
        except (ValueError, TransitionsError) as error:
            problem = str(error)
    message = f"{path}: {problem}, so what its numbers mean is unknown; record it again with TransitionRecorder"
    raise LogError(message)


def transition_columns(spec: SpaceSpec, runs: Sequence[MessageRun]) -> Columns:
    """Decode messages into the columns of `Transitions`.

    Raises:
        Damage: a message is not in the layout of these spaces.
    """
    layout = transition_layout(spec)
    rows, header = _decode(layout, runs)
    if max(rows["terminated"].max(initial=0), rows["truncated"].max(initial=0)) > 1:
        raise Damage(runs[0].offset, "is followed by a transition with a flag that is neither 0 nor 1")
    discrete = isinstance(spec.action, DiscreteAction)
    return {
        "episode": layout.scalar(rows, "episode").astype(np.int64),
        "step": layout.scalar(rows, "step").astype(np.int32),
        "time_ns": header["log_time"].astype(np.int64),
        "observation": layout.vector(rows, "observation").astype(np.float32, copy=False),
        "action": (
            layout.scalar(rows, "action").astype(np.int64)
            if discrete
            else layout.vector(rows, "action").astype(np.float32, copy=False)
        ),
        "reward": layout.scalar(rows, "reward").astype(np.float32),
        "next_observation": layout.vector(rows, "next_observation").astype(np.float32, copy=False),
        "terminated": layout.scalar(rows, "terminated").astype(np.bool_),
        "truncated": layout.scalar(rows, "truncated").astype(np.bool_),
    }


def episode_records(runs: Sequence[MessageRun]) -> Iterable[EpisodeRecord]:
    """Decode messages of the topic `/episode`.

    Raises:
        Damage: a message is not in the layout of that topic.
    """
    rows, header = _decode(episode_layout(), runs)
    if (rows["ended"] >= len(ENDED)).any():
        raise Damage(runs[0].offset, "is followed by a record of an episode with an unknown end")
    for row, time_ns in zip(rows, header["log_time"], strict=True):
        yield EpisodeRecord(
            episode=int(row["episode"]),
            seed=None if row["seed"] == UNKNOWN_SEED else int(row["seed"]),
            episode_return=float(row["return"]),
            length=int(row["length"]),
            ended=ENDED[row["ended"]],
            end_time_ns=int(time_ns),
        )


def _decode(
    layout: MessageLayout, runs: Sequence[MessageRun]
) -> tuple[Shaped[np.ndarray, " message"], Shaped[np.ndarray, " message"]]:
    size = MESSAGE_HEADER.itemsize + layout.size
    for run in runs:
        if run.messages.shape[1] != size:
            found = run.messages.shape[1] - MESSAGE_HEADER.itemsize
            raise Damage(run.offset, f"is a chunk with messages of {found} bytes, but these spaces need {layout.size}")
    messages = np.concatenate([run.messages for run in runs]) if runs else np.empty((0, size), np.uint8)
    broken = layout.broken(messages[:, MESSAGE_HEADER.itemsize :])
    if broken.any():
        ends = np.cumsum([len(run) for run in runs])
        offset = runs[int(np.searchsorted(ends, broken.argmax(), side="right"))].offset
        raise Damage(offset, "is a chunk with a message that is not in the layout of these spaces")
    record = np.dtype([("header", MESSAGE_HEADER), ("message", layout.dtype)])
    records = messages.view(record).reshape(len(messages))
    return records["message"], records["header"]


def _transitions(path: Path, record: RunRecord, columns: Columns) -> Transitions:
    try:
        return Transitions(record.spec, **columns)
    except TransitionsError as error:
        message = f"{path}: {error}"
        raise LogError(message) from error
