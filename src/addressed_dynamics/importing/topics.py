"""Read the topics that an import needs from an MCAP log of any origin, checking the whole file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Literal

from mcap.records import Channel, Schema

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.paths import FieldPath
from addressed_dynamics.importing.series import TopicReader, TopicSeries
from addressed_dynamics.importing.signals import Signal
from addressed_dynamics.logs.container import Content, Damage, MessageRun, Source, scan


def read_topics(
    path: Path,
    signals: Sequence[Signal],
    paths: Sequence[FieldPath],
    *,
    time: Literal["log", "publish"],
    agreement: Agreement,
) -> list[TopicSeries]:
    """Read the signals in the log at `path`.

    Args:
        path: an MCAP log.
        signals: what to read.
        paths: where it is, one path for each signal.
        time: which time of a message counts.
        agreement: what the files before this one looked like.

    Returns:
        One series for each topic, in the order in which `paths` name them.

    Raises:
        LogError: the file is damaged anywhere, cannot be decoded, or lacks a topic or a field; the message says which
            there are.
    """
    readers: dict[str, TopicReader] = {}
    for place, (each, signal) in enumerate(zip(paths, signals, strict=True)):
        reader = readers.setdefault(each.topic, TopicReader(str(path), each.topic, time=time, agreement=agreement))
        reader.want(place, each, signal)
    channels: dict[int, Channel] = {}
    for channel, schema, run in _message_runs(path, channels):
        if channel.topic in readers:
            readers[channel.topic].add(channel, schema, run)
    _check_topics(path, readers, channels)
    return [reader.series() for reader in readers.values()]


def _message_runs(path: Path, channels: dict[int, Channel]) -> Iterator[tuple[Channel, Schema | None, MessageRun]]:
    """Yield the messages of a file, with their channel and schema; `channels` is filled on the way."""
    schemas: dict[int, Schema] = {}
    try:
        for content in _contents(path):
            match content:
                case Schema():
                    schemas[content.id] = content
                case Channel():
                    channels[content.id] = content
                case MessageRun():
                    channel = channels.get(content.channel)
                    if channel is None or (channel.schema_id and channel.schema_id not in schemas):
                        what = "channel" if channel is None else "schema"
                        raise Damage(content.offset, f"has messages whose {what} was not declared before")
                    yield channel, schemas.get(channel.schema_id), content
    except Damage as damage:
        message = (
            f"{path}: byte {damage.offset} {damage.reason}; copy the file again from where it was recorded, "
            "or save what is intact with 'mcap recover'"
        )
        raise LogError(message) from damage


def _contents(path: Path) -> Iterator[Content]:
    try:
        with path.open("rb") as file:
            source = Source(file)
            if not source.size:
                message = f"{path}: the file is empty (0 bytes), but an MCAP log was expected; record it again"
                raise LogError(message)
            yield from scan(source)
    except OSError as error:
        message = f"{path}: the log cannot be read ({error.strerror})"
        raise LogError(message) from error


def _check_topics(path: Path, readers: Mapping[str, TopicReader], channels: Mapping[int, Channel]) -> None:
    known = sorted({channel.topic for channel in channels.values()})
    for topic, reader in readers.items():
        if not len(reader):
            what = "has no messages on" if topic in known else "has no"
            message = f"{path}: the file {what} topic {topic}; its topics are: {', '.join(known) or 'none'}"
            raise LogError(message)
