"""MCAP as a container: records, chunks and checksums, read whole and checked to the last byte.

The records of the package `mcap` are used for what is small. Messages are cut out of their chunk as arrays, because one
Python object per message costs forty times as much. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np
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
# Opcode, length and channel: messages that agree in them form a run.
_SAME = slice(0, 1 + 8 + 2)
# In a chunk record the name of the compression follows three times, a size and a checksum.
_ZSTD = b"\x04\x00\x00\x00zstd"
_ZSTD_OFFSET = _FRAME.size + 8 + 8 + 8 + 4


class Damage(Exception):
    """A place at which a file stops being a sound MCAP file. Never leaves this package."""

    def __init__(self, offset: int, reason: str) -> None:
        super().__init__(reason)
        self.offset = offset
        """Where, in bytes from the start of the file."""
        self.reason = reason
        """What is wrong there, as the rest of a sentence that begins with the place."""


@dataclass(frozen=True)
class Frame:
    """A record of the file, still encoded."""

    offset: int
    """Where it begins, in bytes from the start of the file."""
    opcode: int
    body: memoryview
    """Its bytes after the opcode and the length."""

    @property
    def end(self) -> int:
        """Where the next record begins."""
        return self.offset + _FRAME.size + len(self.body)


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


def frames(data: bytes, start: int) -> Iterator[Frame]:
    """Yield the records from byte `start` to the footer.

    Raises:
        Damage: a record is incomplete, or the data ends without a footer.
    """
    view, offset = memoryview(data), start
    while offset < len(data):
        if offset + _FRAME.size > len(data):
            raise Damage(offset, "is the start of a record, but the file ends inside it")
        opcode, length = _FRAME.unpack_from(data, offset)
        frame = Frame(offset, opcode, view[offset + _FRAME.size : offset + _FRAME.size + length])
        if len(frame.body) < length:
            raise Damage(offset, f"is the start of a record of {length} bytes, but only {len(frame.body)} follow")
        yield frame
        if opcode == Opcode.FOOTER:
            return
        offset = frame.end
    raise Damage(len(data), "is the end of the file, but an index should follow: the recording was not finished")


def scan(data: bytes) -> Iterator[Content]:
    """Yield everything in the data section of a file, then the schemas and channels again, and check the whole file.

    Raises:
        Damage: the file is incomplete, or any of its checksums, lengths or counts is wrong.
    """
    if not data.startswith(MAGIC):
        raise Damage(0, "should begin an MCAP file, but has another signature")
    messages = 0
    data_end: Frame | None = None
    for frame in frames(data, len(MAGIC)):
        if frame.offset == len(MAGIC) and frame.opcode != Opcode.HEADER:
            raise Damage(frame.offset, "should be the header of the file, but is another record")
        if frame.opcode == Opcode.DATA_END:
            data_end = frame
            _check_data(data, frame)
        elif frame.opcode == Opcode.FOOTER:
            _check_summary(data, data_end, frame, messages)
        elif data_end is None or frame.opcode in _REPEATED:
            for content in contents(data, frame):
                messages += len(content) if isinstance(content, MessageRun) else 0
                yield content


def contents(data: bytes, frame: Frame) -> list[Content]:
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
            return list(_records_within(data[frame.offset : frame.end], frame.offset))
        case _:
            return []


def summary_contents(data: bytes) -> list[Content]:
    """Return the schemas and channels that a finished file repeats in its summary; none if there is no sound one."""
    try:
        footer_offset = len(data) - len(MAGIC) - _FRAME.size - 20
        (footer_frame,) = frames(data, max(footer_offset, 0))
        footer = _parse(Footer, footer_frame.body, footer_frame.offset)
        if _summary_checksum(data, footer, footer_frame) != footer.summary_crc:
            return []
        repeated = [frame for frame in frames(data, footer.summary_start) if frame.opcode in _REPEATED]
        return [content for frame in repeated for content in contents(data, frame)]
    except (Damage, ValueError):
        return []


def as_chunk(frame: Frame) -> Frame:
    """Return the frame as a chunk if it has the inside of one: no checksum protects the opcode before it."""
    inside = _ZSTD_OFFSET - _FRAME.size
    is_chunk = frame.body[inside : inside + len(_ZSTD)] == _ZSTD
    return replace(frame, opcode=int(Opcode.CHUNK)) if is_chunk else frame


def next_chunk(data: bytes, start: int) -> int | None:
    """Return where the first intact zstd chunk at or after byte `start` begins, trusting no length before it."""
    found = data.find(_ZSTD, start + _ZSTD_OFFSET)
    while found >= 0:
        offset = found - _ZSTD_OFFSET
        try:
            _chunk_payload(next(frames(data, offset)))
        except Damage:
            found = data.find(_ZSTD, found + 1)
        else:
            return offset
    return None


_REPEATED = (Opcode.SCHEMA, Opcode.CHANNEL)


def _chunk_payload(frame: Frame) -> bytes:
    chunk = _parse(Chunk, frame.body, frame.offset)
    try:
        stream, size = get_chunk_data_stream(chunk, validate_crc=True)
        payload: bytes = stream.read(size)
    except Exception as error:  # zstandard, lz4 and mcap raise a dozen unrelated types on damaged data
        raise Damage(frame.offset, f"is a chunk that cannot be unpacked ({_first_line(error)})") from error
    if len(payload) != chunk.uncompressed_size:
        raise Damage(frame.offset, f"is a chunk of {len(payload)} bytes, but should be of {chunk.uncompressed_size}")
    return payload


def _records_within(payload: bytes, offset: int) -> Iterator[Schema | Channel | MessageRun]:
    position = 0
    while position < len(payload):
        try:
            record = next(frames(payload, position))
        except Damage as damage:
            raise Damage(offset, "is a chunk whose last record is incomplete") from damage
        if record.opcode == Opcode.MESSAGE:
            run = _message_run(payload, position, record.end - position, offset)
            yield run
            position += run.messages.size
        else:
            if record.opcode in _REPEATED:
                yield _parse(Schema if record.opcode == Opcode.SCHEMA else Channel, record.body, offset)
            position = record.end


def _message_run(payload: bytes, position: int, size: int, offset: int) -> MessageRun:
    """Cut out all messages that follow each other from `position` with the same channel and length."""
    if size < MESSAGE_HEADER.itemsize:
        raise Damage(offset, "is a chunk with a message that is shorter than its header")
    count, limit = 1, (len(payload) - position) // size
    # The window doubles, so that a chunk in which two channels alternate costs no more than its length.
    while count < limit:
        window = min(2 * count, limit)
        rows = np.frombuffer(payload, np.uint8, window * size, position).reshape(window, size)
        differs = (rows[count:, _SAME] != rows[0, _SAME]).any(axis=1)
        if differs.any():
            count += int(differs.argmax())
            break
        count = window
    rows = np.frombuffer(payload, np.uint8, count * size, position).reshape(count, size)
    return MessageRun(offset, int(rows[0, : MESSAGE_HEADER.itemsize].view(MESSAGE_HEADER)["channel"][0]), rows)


def _check_data(data: bytes, frame: Frame) -> None:
    expected = _parse(DataEnd, frame.body, frame.offset).data_section_crc
    if expected and zlib.crc32(memoryview(data)[: frame.offset]) != expected:
        raise Damage(frame.offset, "is the end of the data, whose checksum does not match what is before it")


def _check_summary(data: bytes, data_end: Frame | None, frame: Frame, messages: int) -> None:
    footer = _parse(Footer, frame.body, frame.offset)
    if data_end is None:
        raise Damage(frame.offset, "is the end of the file, but the end of its data was not marked before")
    if data[frame.end :] != MAGIC:
        raise Damage(frame.end, "should be the signature at the end of the file, but is something else")
    if footer.summary_crc and footer.summary_crc != _summary_checksum(data, footer, frame):
        raise Damage(data_end.end, "is the start of the index, which fails its checksum")
    if not footer.summary_start:
        return
    for record in frames(data, data_end.end):
        if record.opcode == Opcode.STATISTICS:
            counted = _parse(Statistics, record.body, record.offset).message_count
            if counted != messages:
                raise Damage(record.offset, f"says that there are {counted} messages, but {messages} were found")


def _summary_checksum(data: bytes, footer: Footer, frame: Frame) -> int:
    return zlib.crc32(memoryview(data)[footer.summary_start : frame.end - 4])


def _parse(kind: type[Any], body: memoryview, offset: int) -> Any:
    try:
        return kind.read(ReadDataStream(io.BytesIO(body)))
    except Exception as error:  # mcap's records raise a dozen unrelated types on damaged data
        message = f"is a {kind.__name__.lower()} record that cannot be read ({_first_line(error)})"
        raise Damage(offset, message) from error


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).split("\n", maxsplit=1)[0]
