"""Read a log of transitions, checking everything that can be checked."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Shaped
from mcap.records import Channel, Metadata, Schema
from mcap.writer import MCAP0_MAGIC as MAGIC

from addressed_dynamics.errors import LogError, TransitionsError
from addressed_dynamics.logs.container import MESSAGE_HEADER, Content, Damage, MessageRun, scan
from addressed_dynamics.logs.contents import EpisodeRecord, LogContents, RunRecord
from addressed_dynamics.logs.layout import MessageLayout, message_layout
from addressed_dynamics.logs.schema import (
    ENDED,
    EPISODE_SCHEMA,
    TRANSITION_SCHEMA,
    UNKNOWN_SEED,
    episode_file,
    transition_file,
)
from addressed_dynamics.logs.writer import RUN_RECORD
from addressed_dynamics.transitions import DiscreteAction, SpaceSpec, Transitions


def read_log(path: Path) -> LogContents:
    """Read the log at `path`.

    Raises:
        LogError: there is no such file, it is damaged anywhere, it was not finished, or it is not a log of
            transitions; the message says where, and what can be done.
    """
    data = read_bytes(path)
    found = Found()
    try:
        for content in scan(data):
            found.add(content)
    except Damage as damage:
        message = (
            f"{path}: byte {damage.offset} {damage.reason}; {found.intact} transitions before it are intact: "
            f"'addressed-dynamics recover {path}' writes all that can be saved to a new file"
        )
        raise LogError(message) from damage
    record = run_record(path, found)
    try:
        columns = transition_columns(record.spec, found.runs_of(TRANSITION_SCHEMA))
        episodes = tuple(episode_records(found.runs_of(EPISODE_SCHEMA)))
        transitions = Transitions(record.spec, **columns)
    except Damage as damage:
        message = f"{path}: byte {damage.offset} {damage.reason}; record it again, or ask the program that wrote it"
        raise LogError(message) from damage
    except TransitionsError as error:
        message = f"{path}: {error}"
        raise LogError(message) from error
    _check_episodes(path, transitions, episodes)
    return LogContents(transitions, episodes, record.info)


def read_bytes(path: Path) -> bytes:
    """Return the bytes of an MCAP file.

    Raises:
        LogError: it cannot be read, is empty, or does not begin as an MCAP file does.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        partial = path.with_name(f"{path.name}.partial")
        hint = f"; an unfinished one is there: 'addressed-dynamics recover {partial}'" if partial.exists() else ""
        message = f"{path}: there is no such log{hint}"
        raise LogError(message) from error
    except OSError as error:
        message = f"{path}: the log cannot be read ({error.strerror})"
        raise LogError(message) from error
    if not data:
        message = f"{path}: the file is empty (0 bytes), but an MCAP log was expected; record it again"
        raise LogError(message)
    if not data.startswith(MAGIC):
        message = f"{path}: byte 0 should begin an MCAP log, but the file begins with {data[:8]!r}; give an .mcap file"
        raise LogError(message)
    return data


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


def transition_columns(spec: SpaceSpec, runs: Sequence[MessageRun]) -> dict[str, Shaped[np.ndarray, "step ..."]]:
    """Decode messages into the columns of `Transitions`.

    Raises:
        Damage: a message is not in the layout of these spaces.
    """
    layout = message_layout(transition_file(spec).message_type[0])
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
    rows, header = _decode(message_layout(episode_file().message_type[0]), runs)
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
        if layout.broken(run.messages[:, MESSAGE_HEADER.itemsize :]).any():
            raise Damage(run.offset, "is a chunk with a message that is not in the layout of these spaces")
    messages = np.concatenate([run.messages for run in runs]) if runs else np.empty((0, size), np.uint8)
    record = np.dtype([("header", MESSAGE_HEADER), ("message", layout.dtype)])
    records = messages.view(record).reshape(len(messages))
    return records["message"], records["header"]


def _check_episodes(path: Path, transitions: Transitions, episodes: Sequence[EpisodeRecord]) -> None:
    found = [(int(transitions.episode[rows.start]), rows.stop - rows.start) for rows in transitions.episode_slices()]
    recorded = [(each.episode, each.length) for each in episodes]
    for (episode, length), (record, expected) in zip(found, recorded, strict=False):
        if (episode, length) != (record, expected):
            message = (
                f"{path}: episode {record} should have {expected} transitions, but episode {episode} with {length} was "
                f"found in its place; 'addressed-dynamics recover {path}' writes what fits to a new file"
            )
            raise LogError(message)
    if len(found) != len(recorded):
        message = (
            f"{path}: there are transitions of {len(found)} episodes, but records of {len(recorded)}; "
            f"'addressed-dynamics recover {path}' writes what fits to a new file"
        )
        raise LogError(message)
