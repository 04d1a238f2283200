"""Read the topics that an import needs from MCAP logs of any origin, checking the whole files."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from pathlib import Path

from mcap.records import Channel, Schema

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.paths import FieldPath
from addressed_dynamics.importing.ros_databases import database_runs, is_database
from addressed_dynamics.importing.series import Clock, TopicReader, Turns
from addressed_dynamics.importing.signals import Signal
from addressed_dynamics.logs.container import Content, Damage, MessageRun, Source, scan
from addressed_dynamics.logs.reader import refuse_compressed


def read_topics(
    files: Sequence[Path],
    signals: Sequence[Signal],
    paths: Sequence[FieldPath],
    *,
    clock: Callable[[str], Clock],
    turns: Turns,
    types: tuple[str, ...] = (),
    agreement: Agreement,
) -> list[TopicReader]:
    """Read the signals in the logs of one recording.

    Args:
        files: MCAP logs or databases of ROS 2, in the order of their times.
        signals: what to read.
        paths: where it is, one path for each signal.
        clock: which time of a topic's messages counts.
        turns: numbers the parts of the recording.
        types: folders or files with definitions of messages, for databases that do not carry them.
        agreement: what the files before this recording looked like.

    Returns:
        One reader for each topic, in the order in which `paths` name them.

    Raises:
        LogError: a file is damaged anywhere, or cannot be decoded, or the recording lacks a topic or a field; the
            message says which there are.
    """
    readers: dict[str, TopicReader] = {}
    for place, (each, signal) in enumerate(zip(paths, signals, strict=True)):
        new = TopicReader(each.topic, clock=clock(each.topic), turns=turns, agreement=agreement)
        readers.setdefault(each.topic, new).want(place, each, signal)
    topics = set[str]()
    for path in files:
        for reader in readers.values():
            reader.begin(str(path))
        if is_database(path):
            _refuse_times(path, [topic for topic in readers if clock(topic) == "publish"])
        channels: dict[int, Channel] = {}
        for channel, schema, run in message_runs(path, channels, topics=readers, types=types):
            if channel.topic in readers:
                readers[channel.topic].add(channel, schema, run)
        topics |= {channel.topic for channel in channels.values()}
    _check_topics(files, readers, topics)
    return list(readers.values())


def message_runs(
    path: Path, channels: dict[int, Channel], *, topics: Collection[str] | None = None, types: tuple[str, ...] = ()
) -> Iterator[tuple[Channel, Schema | None, MessageRun]]:
    """Yield the messages of a file, with their channel and schema; `channels` is filled on the way.

    Args:
        path: an MCAP log or a database of ROS 2.
        channels: all channels by their number.
        topics: whose messages matter, None for all; others may come all the same.
        types: folders or files with definitions of messages, for databases that do not carry them.

    Raises:
        LogError: the file is damaged, or definitions are missing.
    """
    if is_database(path):
        yield from database_runs(path, channels, topics, types)
        return
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
            refuse_compressed(path, source)
            yield from scan(source)
    except OSError as error:
        message = f"{path}: the log cannot be read ({error.strerror})"
        raise LogError(message) from error


def _refuse_times(path: Path, topics: Sequence[str]) -> None:
    if topics:
        message = (
            f"{path}: a .db3 file says when each message was recorded, not when it was published; let the 'time' of "
            f"{topics[0]} be log or header"
        )
        raise LogError(message)


def _check_topics(files: Sequence[Path], readers: Mapping[str, TopicReader], topics: set[str]) -> None:
    where = str(files[0]) + (f" and the {len(files) - 1} files that follow it" if len(files) > 1 else "")
    for topic, reader in readers.items():
        if not len(reader):
            what = "has no messages on" if topic in topics else "has no"
            message = f"{where}: the file {what} topic {topic}; its topics are: {', '.join(sorted(topics)) or 'none'}"
            raise LogError(message)
