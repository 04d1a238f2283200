"""Save what is intact in a log that is damaged or was never finished."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC as MAGIC

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.logs.bulk import write_log
from addressed_dynamics.logs.container import (
    MESSAGE_HEADER,
    Damage,
    MessageRun,
    Source,
    as_chunk,
    contents,
    frames,
    next_chunk,
    summary_contents,
)
from addressed_dynamics.logs.contents import EpisodeRecord, RunRecord
from addressed_dynamics.logs.decoding import Columns, Found, episode_records, run_record, transition_columns
from addressed_dynamics.logs.log_file import EPISODE_CHANNEL, TRANSITION_CHANNEL
from addressed_dynamics.logs.reader import open_source
from addressed_dynamics.logs.schema import EPISODE_SCHEMA, TRANSITION_SCHEMA


@dataclass(frozen=True)
class Loss:
    """A stretch of the file that could not be saved."""

    offset: int
    """Where the damage was noticed, in bytes from the start of the file."""
    size: int
    """Bytes from there to the next intact chunk, or to the end of the file."""
    reason: str
    """What is wrong at `offset`, as the rest of a sentence that begins with the place."""


@dataclass(frozen=True)
class Gap:
    """Transitions that are missing before one that was saved."""

    transitions: int
    """How many: known from the numbers that messages carry."""
    episodes: tuple[int | None, int]
    """The episodes of the transitions on both sides; None at the beginning of the log."""
    time_ns: tuple[int | None, int]
    """Log times of the transitions on both sides."""


@dataclass(frozen=True)
class RecoveryReport:
    """What came out of a recovery."""

    source: Path
    target: Path
    transitions: int
    """Transitions in the new log."""
    episodes: int
    """Episodes in the new log."""
    cut_episodes: int
    """Those of them that are marked as cut: their end was not recorded, or is lost."""
    transitions_missing: int
    """Transitions that are known to be missing between those that were saved, or could not be kept because steps of
    their episode before them are missing; how many followed the last one saved is not known."""
    messages: Mapping[str, int]
    """Intact messages of each topic."""
    saved_episodes: tuple[int, int]
    """The first and the last episode in the new log."""
    saved_time_ns: tuple[int, int]
    """Log times of the first and the last transition in it."""
    gaps: tuple[Gap, ...]
    """Where transitions are missing, in order; what was lost after the last one saved leaves no trace."""
    losses: tuple[Loss, ...]
    """The stretches of the file that were lost, in order."""

    @property
    def bytes_lost(self) -> int:
        """Bytes in all the stretches that were lost."""
        return sum(loss.size for loss in self.losses)


def recover_log(source: Path, target: Path) -> RecoveryReport:
    """Write a new log of all that is intact in `source`, which is left as it is.

    Every complete chunk with the right checksum is taken, wherever it is. Of an episode with a gap, the steps before
    the gap are kept. An episode without its end is marked truncated on its last step.

    Raises:
        LogError: `source` cannot be read or has no transition that can be saved, or `target` exists or cannot be
            written.
    """
    if target.exists():
        message = f"{target}: the file exists, and a recovery overwrites nothing; choose another name with --output"
        raise LogError(message)
    with open_source(source) as data:
        found, losses = _salvage(data)
    record = run_record(source, found)
    runs = found.runs_of(TRANSITION_SCHEMA)
    try:
        columns = transition_columns(record.spec, runs)
        ends = {each.episode: each for each in episode_records(found.runs_of(EPISODE_SCHEMA))}
    except Damage as damage:
        message = f"{source}: byte {damage.offset} {damage.reason}, so nothing can be recovered"
        raise LogError(message) from damage
    stretches = list(_stretches(columns))
    if not stretches:
        message = f"{source}: no complete chunk of transitions is in it, so nothing can be recovered"
        raise LogError(message)
    kept = sum(rows.stop - rows.start for rows in stretches)
    cut = _write(target, record, columns, stretches, ends)
    gaps = _gaps(runs, columns)
    return RecoveryReport(
        source=source,
        target=target,
        transitions=kept,
        episodes=len(stretches),
        cut_episodes=cut,
        transitions_missing=sum(gap.transitions for gap in gaps) + len(columns["episode"]) - kept,
        messages=_messages(found),
        saved_episodes=(int(columns["episode"][stretches[0].start]), int(columns["episode"][stretches[-1].start])),
        saved_time_ns=(int(columns["time_ns"][stretches[0].start]), int(columns["time_ns"][stretches[-1].stop - 1])),
        gaps=gaps,
        losses=tuple(losses),
    )


def _salvage(data: Source) -> tuple[Found, list[Loss]]:
    """Walk along the records; after damage, go on at the next intact chunk after the last one that was taken."""
    found, losses = Found(), []
    start: int | None = len(MAGIC)
    while start is not None:
        sound, offset, reason = start, data.size, ""
        try:
            for frame in map(as_chunk, frames(data, start)):
                if frame.opcode in {Opcode.DATA_END, Opcode.FOOTER}:
                    offset = frame.offset
                    break
                for content in contents(frame):
                    found.add(content)
                if frame.opcode == Opcode.CHUNK:
                    sound = frame.end
        except Damage as damage:
            offset, reason = damage.offset, damage.reason
        resume = next_chunk(data, max(sound, start + 1))
        if resume is not None and not reason:
            reason = "seems to be the end of the data, but more of them follow"
        if reason:
            losses.append(Loss(offset, max((data.size if resume is None else resume) - offset, 0), reason))
        start = resume
    _name_channels(data, found)
    return found, losses


def _name_channels(data: Source, found: Found) -> None:
    """Find out which channel is which if the first chunk, which says so, is lost."""
    if not found.channels_of(TRANSITION_SCHEMA):
        for content in summary_contents(data):
            found.add(content)
    if not found.channels and found.metadata:
        # No summary either: our own logs always number their channels in the same way.
        for number, schema in ((TRANSITION_CHANNEL, TRANSITION_SCHEMA), (EPISODE_CHANNEL, EPISODE_SCHEMA)):
            found.add(Schema(id=number, data=b"", encoding=SchemaEncoding.Protobuf, name=schema))
            found.add(Channel(number, schema, MessageEncoding.Protobuf, {}, schema_id=number))


def _stretches(columns: Columns) -> Iterator[slice]:
    """Yield the rows of each episode, or of its first unbroken part."""
    episode, step = columns["episode"], columns["step"]
    goes_on = (episode[1:] == episode[:-1]) & (step[1:] == step[:-1] + 1)
    bounds = np.concatenate([[0], np.flatnonzero(~goes_on) + 1, [len(episode)]]) if len(episode) else np.zeros(1, int)
    seen: set[int] = set()
    for start, stop in zip(bounds[:-1].tolist(), bounds[1:].tolist(), strict=True):
        if int(episode[start]) not in seen:
            seen.add(int(episode[start]))
            yield slice(start, stop)


def _messages(found: Found) -> dict[str, int]:
    counts = dict.fromkeys((channel.topic for channel in found.channels.values()), 0)
    for run in found.runs:
        if run.channel in found.channels:
            counts[found.channels[run.channel].topic] += len(run)
    return counts


def _gaps(runs: list[MessageRun], columns: Columns) -> tuple[Gap, ...]:
    """Return where the numbers of the messages jump."""
    headers = np.concatenate([run.messages[:, : MESSAGE_HEADER.itemsize] for run in runs]).view(MESSAGE_HEADER)
    numbers = headers["sequence"][:, 0].astype(np.int64)
    missing = np.diff(numbers, prepend=-1) - 1
    episode, time_ns = columns["episode"].tolist(), columns["time_ns"].tolist()
    return tuple(
        Gap(
            transitions=int(missing[row]),
            episodes=(episode[row - 1] if row else None, episode[row]),
            time_ns=(time_ns[row - 1] if row else None, time_ns[row]),
        )
        for row in np.flatnonzero(missing > 0).tolist()
    )


def _write(
    target: Path, record: RunRecord, columns: Columns, stretches: list[slice], ends: dict[int, EpisodeRecord]
) -> int:
    """Write the new log and return how many of its episodes are cut."""
    cut = [_is_cut(columns, rows, ends) for rows in stretches]
    # `write_log` marks the last step of an episode without an end.
    truncated = columns["truncated"].copy()
    truncated[[rows.stop - 1 for rows, is_cut in zip(stretches, cut, strict=True) if is_cut]] = False
    kept = np.concatenate([np.arange(rows.start, rows.stop) for rows in stretches])
    saved = {name: column[kept] for name, column in (columns | {"truncated": truncated}).items()}
    seeds = [end.seed if (end := ends.get(int(columns["episode"][rows.start]))) else None for rows in stretches]
    try:
        with atomic_path(target) as temporary:
            write_log(temporary, Transitions(record.spec, **saved), run=record.info, topic=record.topic, seeds=seeds)
    except LogError as error:
        message = f"{target}: the new log cannot be written ({error.__cause__ or error}); make room and recover again"
        raise LogError(message) from error
    return sum(cut)


def _is_cut(columns: Columns, rows: slice, ends: dict[int, EpisodeRecord]) -> bool:
    end, last = ends.get(int(columns["episode"][rows.start])), rows.stop - 1
    complete = columns["terminated"][last] or columns["truncated"][last]
    return not complete or (end is not None and end.ended == "cut")
