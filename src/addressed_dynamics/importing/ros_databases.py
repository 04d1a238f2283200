"""Databases of ROS 2 (`.db3`), the storage of its bags before MCAP."""

from __future__ import annotations

import sqlite3
import struct
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import TypeAlias

import numpy as np
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import SchemaEncoding

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.ros_bags import distro_beside
from addressed_dynamics.importing.ros_types import Definitions
from addressed_dynamics.logs.container import MESSAGE_HEADER, MessageRun

BATCH_BYTES = 2**20
"""Messages of a database that are in memory at once, unless a single one is larger."""
LAST_CHANNEL = 2**16 - 1
"""The highest number of a topic, which is that of a channel in MCAP."""
LARGEST_MESSAGE = 2**30
"""A message that is larger is not read."""
LONGEST_REASON = 200
"""Most characters of what SQLite says that an error repeats."""

Run: TypeAlias = tuple[Channel, Schema | None, MessageRun]
"""Messages with their channel and schema."""

_Message: TypeAlias = tuple[int, int, bytes]
# Topic, time and content.
_HEADER = struct.Struct("<BQHIQQ")
# Opcode, length, channel, sequence, log time and publish time: `MESSAGE_HEADER` for one message at a time.
_FRAME_BYTES = 9
_SQLITE = b"SQLite format 3\x00"


def is_database(path: Path) -> bool:
    """Say whether `path` is a database, by its name or how it begins."""
    if path.suffix == ".db3":
        return True
    try:
        with path.open("rb") as file:
            return file.read(len(_SQLITE)) == _SQLITE
    except OSError:
        return False  # whoever reads it says why


def times_in(path: Path) -> tuple[int, int] | None:
    """Return the first and the last time in a database; None if there is none, or it is damaged."""
    try:
        with open_database(path) as database:
            first, last = database.execute("SELECT min(timestamp), max(timestamp) FROM messages").fetchone()
    except LogError:
        return None
    return (first, last) if isinstance(first, int) and isinstance(last, int) else None


def database_runs(
    path: Path, channels: dict[int, Channel], topics: Collection[str] | None, types: tuple[str, ...]
) -> Iterator[Run]:
    """Yield the messages of a database; `channels` is filled with all topics.

    They come in the order of recording, a batch at a time. Both of their times are that of the database.

    Args:
        path: the database.
        channels: all channels by their number.
        topics: whose messages matter, None for all; the others are not loaded.
        types: folders or files with definitions of messages, if the database has none.

    Raises:
        LogError: the database is damaged, unfinished or no bag, or a definition is found nowhere.
    """
    with open_database(path) as database:
        tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master")}
        kinds: dict[int, str] = {}
        query = "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        for number, topic, kind, encoding in database.execute(query):
            if not isinstance(number, int) or not 0 <= number <= LAST_CHANNEL:
                raise _damaged(path, f"the number of the topic {topic} is {number}")
            if not f"{topic}{kind}{encoding}".isprintable():
                raise _damaged(path, f"topic {number} is called {topic!r}, of type {kind!r} in {encoding!r}")
            channels[number] = Channel(number, str(topic), str(encoding), {}, number)
            if topics is None or topic in topics:
                kinds[number] = str(kind)
        schemas = _own_schemas(path, database) if "message_definitions" in tables else {}
        undefined = sorted(set(kinds.values()) - schemas.keys())
        for kind, text in Definitions(path, types, _distro(path, database, tables)).complete(undefined).items():
            schemas[kind] = _schema(kind, SchemaEncoding.ROS2, text)
        for run in _database_messages(path, database, set(channels), set(kinds)):
            yield channels[run.channel], schemas[kinds[run.channel]], run


def _own_schemas(path: Path, database: sqlite3.Connection) -> dict[str, Schema]:
    schemas: dict[str, Schema] = {}
    rows = database.execute("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions")
    for kind, encoding, text in rows:
        if not f"{kind}{encoding}".isprintable():
            raise _damaged(path, f"the type {kind!r} is defined in {encoding!r}")
        if text:
            schemas[str(kind)] = _schema(str(kind), str(encoding), str(text))
    return schemas


def _schema(kind: str, encoding: str, text: str) -> Schema:
    return Schema(id=0, name=kind, encoding=encoding, data=text.encode())


def _database_messages(
    path: Path, database: sqlite3.Connection, known: Collection[int], wanted: Collection[int]
) -> Iterator[MessageRun]:
    """Yield the messages of the wanted topics in the order of recording."""
    marks = ", ".join("?" * len(wanted))
    # Every row is looked at, but the content of a message is loaded only if it is wanted.
    query = f"SELECT id, topic_id, timestamp, CASE WHEN topic_id IN ({marks}) THEN data END FROM messages ORDER BY id"
    batch, size, before = list[_Message](), 0, -1
    for row, topic, time, data in database.execute(query, list(wanted)):
        if not (isinstance(row, int) and row > before and topic in known and isinstance(time, int) and time >= 0):
            reason = f"message {row}, after message {before}, is out of order, of no topic or without a time"
            raise _damaged(path, reason)
        before = row
        if topic not in wanted:
            continue
        if not isinstance(data, bytes):
            raise _damaged(path, f"message {row} has no content")
        batch.append((topic, time, data))
        size += len(data)
        if size >= BATCH_BYTES:
            yield from _runs(batch)
            batch, size = [], 0
    yield from _runs(batch)


def _runs(messages: Sequence[_Message]) -> Iterator[MessageRun]:
    """Yield messages, those of one topic and one length that follow each other at once."""
    for (topic, length), group in groupby(messages, key=lambda message: (message[0], len(message[2]))):
        size = MESSAGE_HEADER.itemsize - _FRAME_BYTES + length
        encoded = [_HEADER.pack(Opcode.MESSAGE, size, topic, 0, time, time) + data for _, time, data in group]
        yield MessageRun(0, topic, np.frombuffer(b"".join(encoded), np.uint8).reshape(len(encoded), -1))


def _distro(path: Path, database: sqlite3.Connection, tables: Collection[str]) -> str:
    """Return the distribution of ROS 2 that made a database, as it or its bag says; empty if neither does."""
    own = database.execute("SELECT ros_distro FROM schema").fetchone() if "schema" in tables else None
    return str(own[0]) if own else distro_beside(path)


@contextmanager
def open_database(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database to read from it; nothing is written, not even beside it.

    Raises:
        LogError: it cannot be read, was not closed, or is found to be damaged while it is open.
    """
    for end in ("-wal", "-journal"):
        rest = path.with_name(path.name + end)
        if rest.is_file() and rest.stat().st_size:
            message = (
                f"{path}: its recording was killed, and {rest.name} has what is missing in it; in a copy of both, "
                f"sqlite3 {path.name} 'PRAGMA wal_checkpoint(TRUNCATE)' puts it in"
            )
            raise LogError(message)
    try:
        if not path.stat().st_size:
            message = f"{path}: the file is empty (0 bytes), but a bag was expected; record it again"
            raise LogError(message)
        # Nothing is written beside an immutable file, so that it may lie where nobody can write.
        with closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LARGEST_MESSAGE)
            database.text_factory = partial(str, encoding="utf-8", errors="replace")
            yield database
    except OSError as error:
        message = f"{path}: the file cannot be read ({error.strerror})"
        raise LogError(message) from error
    except (sqlite3.Error, MemoryError, UnicodeDecodeError) as error:  # what damaged bytes make of the module
        raise _damaged(path, str(error) or "a size that makes no sense") from error


def _damaged(path: Path, reason: str) -> LogError:
    # SQLite quotes definitions, which have lines.
    line = " ".join(reason.split())[:LONGEST_REASON]
    return LogError(
        f"{path}: the file is damaged or no bag ({line}); copy it again from where it was recorded, or save what is "
        f"intact with sqlite3 {path} .recover"
    )
