"""What the messages of a log say: which channel is which, and messages decoded into arrays."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Shaped
from mcap.records import Channel, Metadata, Schema

from addressed_dynamics.base.errors import LogError, TransitionsError
from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec
from addressed_dynamics.logs.container import MESSAGE_HEADER, Content, Damage, MessageRun
from addressed_dynamics.logs.contents import EpisodeRecord, RunRecord
from addressed_dynamics.logs.layout import MessageLayout
from addressed_dynamics.logs.log_file import RUN_RECORD
from addressed_dynamics.logs.schema import (
    ENDED,
    TRANSITION_SCHEMA,
    UNKNOWN_SEED,
    episode_layout,
    transition_layout,
)

Columns = dict[str, Shaped[np.ndarray, "step ..."]]
"""The columns of `Transitions` by name."""


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
        wrong = (rows["terminated"] > 1) | (rows["truncated"] > 1)
        raise Damage(
            _offset(runs, int(wrong.argmax())), "is followed by a transition with a flag that is neither 0 nor 1"
        )
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
        "exogenous": (
            layout.vector(rows, "exogenous").astype(np.float32, copy=False)
            if spec.exogenous
            else np.empty((len(rows), 0), np.float32)
        ),
    }


def episode_records(runs: Sequence[MessageRun]) -> Iterable[EpisodeRecord]:
    """Decode messages of the topic `/episode`.

    Raises:
        Damage: a message is not in the layout of that topic.
    """
    rows, header = _decode(episode_layout(), runs)
    wrong = rows["ended"] >= len(ENDED)
    if wrong.any():
        raise Damage(_offset(runs, int(wrong.argmax())), "is followed by a record of an episode with an unknown end")
    names = ("episode", "seed", "return", "length", "ended")
    for episode, seed, total, length, ended, time_ns in zip(
        *(rows[name].tolist() for name in names), header["log_time"].tolist(), strict=True
    ):
        yield EpisodeRecord(
            episode=episode,
            seed=None if seed == UNKNOWN_SEED else seed,
            episode_return=total,
            length=length,
            ended=ENDED[ended],
            end_time_ns=time_ns,
        )


def _offset(runs: Sequence[MessageRun], row: int) -> int:
    """Return where the chunk begins that a row of all these messages is in."""
    ends = np.cumsum([len(run) for run in runs])
    return runs[int(np.searchsorted(ends, row, side="right"))].offset


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
        raise Damage(
            _offset(runs, int(broken.argmax())), "is a chunk with a message that is not in the layout of these spaces"
        )
    record = np.dtype([("header", MESSAGE_HEADER), ("message", layout.dtype)])
    records = messages.view(record).reshape(len(messages))
    return records["message"], records["header"]
