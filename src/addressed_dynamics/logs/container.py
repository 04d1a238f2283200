"""MCAP as a container: records, chunks and checksums, read one record at a time and checked to the last byte.

The records of the package `mcap` are used for what is small. Messages are cut out of their chunk as arrays, because one
Python object per message costs forty times as much. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, BinaryIO, TypeAlias

import numpy as np
import zstandard
from jaxtyping import UInt8
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, DataEnd, Footer, Metadata, Schema, Statistics
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC as MAGIC

MESSAGE_HEADER = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
"""What stands before the data of a message."""

_FRAME = struct.Struct("<BQ")
_CHANNEL = struct.Struct("<H")
# In a chunk record the name of the compression follows three times, a size and a checksum.
_ZSTD = b"\x04\x00\x00\x00zstd"
_ZSTD_OFFSET = _FRAME.size + 8 + 8 + 8 + 4
_WINDOW = 1024 * 1024
_LARGEST_CHUNK = 2**30
_LEAST_COMPARED = 128
"""Messages whose heads cost hardly more to compare than two: less than a microsecond."""


class Damage(Exception):
    """A place at which a file stops being a sound MCAP file. Never leaves this package."""

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(reason)
        self.offset = offset
        """Where, in bytes from the start of the file."""
        self.reason = reason
        """What is wrong there, as the rest of a sentence that begins with the place."""


class Source:
    """A file to read from anywhere, never more of it than is asked for."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.size = file.seek(0, io.SEEK_END)
        """Its length in bytes."""

    def read(self, offset: int, length: int) -> bytes:
        """Return the bytes from `offset` on, fewer than `length` at the end of the file."""
        if offset > self.size:  # a damaged length may lead further than a file can be sought
            return b""
        self._file.seek(offset)
        return self._file.read(length)


@dataclass(frozen=True)
class Frame:
    """A record of the file, still encoded."""

    offset: int
    """Where it begins, in bytes from the start of the file."""
    opcode: int
    body: bytes
    """Its bytes after the opcode and the length."""

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.offset + _FRAME.size + len(self.body)

    @property
    def head(self) -> bytes:
        """The opcode and the length."""
        return _FRAME.pack(self.opcode, len(self.body))


@dataclass(frozen=True)
class MessageRun:
    """Messages of one channel and of one length, one after the other."""

    offset: int
    """Where their chunk begins, in bytes from the start of the file."""
    channel: int
    """The channel's id."""
    messages: UInt8[np.ndarray, "message byte"]
    """The messages with their headers, encoded."""

    def __len__(self) -> int:
        return len(self.messages)


Content: TypeAlias = Schema | Channel | Metadata | MessageRun
"""What a file holds, decoded as far as it can be without knowing its schemas."""


def frames(source: Source, start: int) -> Iterator[Frame]:
    """Yield the records from byte `start` to the footer.

    Raises:
        Damage: a record is incomplete, or the file ends without a footer.
    """
    offset = start
    while offset < source.size:
        head = source.read(offset, _FRAME.size)
        if len(head) < _FRAME.size:
            raise Damage(offset, "is the start of a record, but the file ends inside it")
        opcode, length = _FRAME.unpack(head)
        left = source.size - offset - _FRAME.size
        if length > left:
            raise Damage(offset, f"is the start of a record of {length} bytes, but only {left} follow")
        frame = Frame(offset, opcode, source.read(offset + _FRAME.size, length))
        yield frame
        if opcode == Opcode.FOOTER:
            return
        offset = frame.end
    raise Damage(source.size, "is the end of the file, but an index should follow: the recording was not finished")


def scan(source: Source) -> Iterator[Content]:
    """Yield everything in the data section of a file, then the schemas and channels again, and check the whole file.

    Raises:
        Damage: the file is incomplete, or any of its checksums, lengths or counts is wrong.
    """
    if source.read(0, len(MAGIC)) != MAGIC:
        raise Damage(0, "should begin an MCAP file, but has another signature")
    messages, checksum = 0, zlib.crc32(MAGIC)
    data_end: Frame | None = None
    for frame in frames(source, len(MAGIC)):
        if frame.offset == len(MAGIC) and frame.opcode != Opcode.HEADER:
            raise Damage(frame.offset, "should be the header of the file, but is another record")
        if frame.opcode == Opcode.DATA_END:
            data_end = frame
            _check_data(frame, checksum)
        elif frame.opcode == Opcode.FOOTER:
            _check_summary(source, data_end, frame, messages)
        elif data_end is None or frame.opcode in _REPEATED:
            for content in contents(frame):
                messages += len(content) if isinstance(content, MessageRun) else 0
                yield content
        if data_end is None:
            checksum = zlib.crc32(frame.body, zlib.crc32(frame.head, checksum))


def contents(frame: Frame) -> list[Content]:
    """Return what a record of the data section holds: nothing if it is an index.

    Raises:
        Damage: the record is malformed, or is a chunk that fails its checksum.
    """
    match frame.opcode:
        case Opcode.CHUNK:
            return list(_records_within(_chunk_payload(frame), frame.offset))
        case Opcode.METADATA:
            return [_parse(Metadata, frame.body, frame.offset)]
        case Opcode.SCHEMA | Opcode.CHANNEL | Opcode.MESSAGE:
            return list(_records_within(frame.head + frame.body, frame.offset))
        case _:
            return []


def summary_contents(source: Source) -> list[Content]:
    """Return the schemas and channels that a finished file repeats in its summary; none if there is no sound one."""
    try:
        footer_offset = source.size - len(MAGIC) - _FRAME.size - 20
        (footer_frame,) = frames(source, max(footer_offset, 0))
        footer = _parse(Footer, footer_frame.body, footer_frame.offset)
        if _summary_checksum(source, footer, footer_frame) != footer.summary_crc:
            return []
        repeated = [frame for frame in frames(source, footer.summary_start) if frame.opcode in _REPEATED]
        return [content for frame in repeated for content in contents(frame)]
    except (Damage, ValueError):
        return []


def as_chunk(frame: Frame) -> Frame:
    """Return the frame as a chunk if it has the inside of one: no checksum protects the opcode before it."""
    inside = _ZSTD_OFFSET - _FRAME.size
    is_chunk = frame.body[inside : inside + len(_ZSTD)] == _ZSTD
    return replace(frame, opcode=int(Opcode.CHUNK)) if is_chunk else frame


def next_chunk(source: Source, start: int) -> int | None:
    """Return where the first intact zstd chunk at or after byte `start` begins, trusting no length before it."""
    for found in _occurrences(source, _ZSTD, start + _ZSTD_OFFSET):
        offset = found - _ZSTD_OFFSET
        try:
            _chunk_payload(next(frames(source, offset)))
        except Damage:
            continue
        return offset
    return None


def _occurrences(source: Source, wanted: bytes, start: int) -> Iterator[int]:
    while start < source.size:
        window = source.read(start, _WINDOW)
        found = window.find(wanted)
        while found >= 0:
            yield start + found
            found = window.find(wanted, found + 1)
        # The next window begins before the end of this one, where an occurrence may be cut in two.
        start += max(len(window) - len(wanted) + 1, 1)


_REPEATED = (Opcode.SCHEMA, Opcode.CHANNEL)


def _chunk_payload(frame: Frame) -> bytes:
    chunk = _parse(Chunk, frame.body, frame.offset)
    if chunk.uncompressed_size > _LARGEST_CHUNK:
        raise Damage(frame.offset, f"is a chunk of {chunk.uncompressed_size} bytes, but {_LARGEST_CHUNK} are the most")
    try:
        # The size within a damaged zstd frame would be believed, and so much memory asked for.
        if chunk.compression == "zstd" and zstandard.frame_content_size(chunk.data) > chunk.uncompressed_size:
            raise Damage(frame.offset, "is a chunk that is larger than it says")
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        payload: bytes = stream.read(size)
    except Damage:
        raise
    except Exception as error:  # zstandard, lz4 and mcap raise a dozen unrelated types on damaged data
        raise Damage(frame.offset, f"is a chunk that cannot be unpacked ({_first_line(error)})") from error
    if len(payload) != chunk.uncompressed_size:
        raise Damage(frame.offset, f"is a chunk of {len(payload)} bytes, but should be of {chunk.uncompressed_size}")
    return payload


def _records_within(payload: bytes, offset: int) -> Iterator[Schema | Channel | MessageRun]:
    position, expected = 0, dict[tuple[int, int], int]()
    while position < len(payload):
        size, opcode = _record_within(payload, position, offset)
        if opcode == Opcode.MESSAGE:
            if size < MESSAGE_HEADER.itemsize:
                raise Damage(offset, "is a chunk with a message that is shorter than its header")
            channel = _CHANNEL.unpack_from(payload, position + _FRAME.size)[0]
            rows = _equal_messages(payload, position, size, expected.get((channel, size), 1))
            expected[channel, size] = len(rows)
            yield MessageRun(offset, channel, rows)
            position += rows.size
        else:
            if opcode in _REPEATED:
                body = payload[position + _FRAME.size : position + size]
                try:
                    yield _described(opcode, body)
                except Damage as damage:
                    raise Damage(offset, damage.reason) from damage
            position += size


def _record_within(payload: bytes, position: int, offset: int) -> tuple[int, int]:
    """Return the size of the record at `position`, with its head, and its opcode."""
    left = len(payload) - position - _FRAME.size
    if left >= 0:
        opcode, length = _FRAME.unpack_from(payload, position)
        if length <= left:
            return _FRAME.size + length, opcode
    raise Damage(offset, "is a chunk whose last record is incomplete")


def _equal_messages(payload: bytes, position: int, size: int, expected: int) -> UInt8[np.ndarray, "message byte"]:
    """Return all messages that follow each other from `position` with the same channel and length.

    The window that is compared starts with as many as were found the last time and doubles, so that neither long runs
    nor channels that alternate cost more than the chunk's length.
    """
    count, limit = 1, (len(payload) - position) // size
    rows = np.frombuffer(payload, _compared(size), limit, position)
    head, tail = rows["head"], rows["tail"]
    window = max(_LEAST_COMPARED, expected + 1)
    while count < limit:
        equal = head[count:window] == head[0]
        equal &= tail[count:window] == tail[0]
        if not equal.all():
            count += int(equal.argmin())
            break
        count, window = count + len(equal), 2 * window
    return np.frombuffer(payload, np.uint8, count * size, position).reshape(count, size)


@lru_cache(maxsize=64)
def _compared(size: int) -> np.dtype[Any]:
    """Return a message of so many bytes as its opcode, length and channel, in two pieces that overlap."""
    return np.dtype({"names": ["head", "tail"], "formats": ["<u8", "<u4"], "offsets": [0, 7], "itemsize": size})


def _check_data(frame: Frame, checksum: int) -> None:
    expected = _parse(DataEnd, frame.body, frame.offset).data_section_crc
    if expected and checksum != expected:
        raise Damage(frame.offset, "is the end of the data, whose checksum does not match what is before it")


def _check_summary(source: Source, data_end: Frame | None, frame: Frame, messages: int) -> None:
    footer = _parse(Footer, frame.body, frame.offset)
    if data_end is None:
        raise Damage(frame.offset, "is the end of the file, but the end of its data was not marked before")
    if source.read(frame.end, len(MAGIC) + 1) != MAGIC:
        raise Damage(frame.end, "should be the signature at the end of the file, but is something else")
    if footer.summary_crc and footer.summary_crc != _summary_checksum(source, footer, frame):
        raise Damage(data_end.end, "is the start of the index, which fails its checksum")
    if not footer.summary_start:
        return
    for record in frames(source, data_end.end):
        if record.opcode == Opcode.STATISTICS:
            counted = _parse(Statistics, record.body, record.offset).message_count
            if counted != messages:
                raise Damage(record.offset, f"says that there are {counted} messages, but {messages} were found")


def _summary_checksum(source: Source, footer: Footer, frame: Frame) -> int:
    start = footer.summary_start or frame.offset  # a file without a summary has a checksum of its footer
    return zlib.crc32(source.read(start, max(frame.end - 4 - start, 0)))


def _parse(kind: type[Any], body: bytes, offset: int) -> Any:
    try:
        return kind.read(ReadDataStream(io.BytesIO(body)))
    except Exception as error:  # mcap's records raise a dozen unrelated types on damaged data
        message = f"is a {kind.__name__.lower()} record that cannot be read ({_first_line(error)})"
        raise Damage(offset, message) from error


@lru_cache(maxsize=64)
def _described(opcode: int, body: bytes) -> Schema | Channel:
    """Parse a schema or a channel, which every chunk of a log repeats; callers leave it as it is.

    Raises:
        Damage: it cannot be read; at no known place.
    """
    found: Schema | Channel = _parse(Schema if opcode == Opcode.SCHEMA else Channel, body, 0)
    return found


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).split("\n", maxsplit=1)[0]
