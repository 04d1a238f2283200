"""Write an MCAP file chunk by chunk, each chunk built by the caller as one block of bytes.

`mcap.Writer` costs some 5 µs for each message, because it makes an object and three index entries of it. Here a chunk
costs the same however many messages are in it: it is compressed, summed and indexed as a whole, by the records of the
package `mcap`. What an `mcap.Writer` would have written differs in one thing: every chunk begins with all schemas and
channels, so that it can be read without any other. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from io import BufferedWriter

import lz4.frame
import numpy as np
import zstandard
from jaxtyping import Shaped, UInt8
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC as MAGIC

INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])
"""Where a message is: its time in nanoseconds, and its first byte from the start of its chunk."""

_ZSTD_LEVEL = 1
"""`mcap.Writer` uses 3, which takes twice as long for logs of transitions and makes them no smaller."""
_INDEX_HEADER = struct.Struct("<BQHI")
_SUMMED_FOOTER = struct.Struct("<BQQQ")


@dataclass
class _Counts:
    """What the statistics record tells."""

    messages: dict[int, int] = field(default_factory=dict)
    """Messages by channel."""
    start_time: int | None = None
    end_time: int = 0

    def add(self, channel: int, messages: int) -> None:
        self.messages[channel] = self.messages.get(channel, 0) + messages

    def extend(self, start_time: int, end_time: int) -> None:
        self.start_time = start_time if self.start_time is None else min(self.start_time, start_time)
        self.end_time = max(self.end_time, end_time)


class ContainerWriter:
    """Writes one MCAP file to an open binary file.

    Args:
        file: where to write; it is neither closed nor synchronised.
        library: what the file says of the program that wrote it.
        compression: `zstd`, `lz4`, or nothing.
    """

    def __init__(self, file: BufferedWriter, *, library: str, compression: str = "zstd") -> None:
        self._file = file
        self._compression = compression
        self._compress = _compressor(compression)
        self._size, self._crc = 0, 0
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks: list[ChunkIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts = _Counts()
        self.description: UInt8[np.ndarray, " byte"] = np.empty(0, np.uint8)
        """The schemas and channels so far, encoded: how every chunk begins."""
        self._write(MAGIC)
        self._write(_encode(Header(profile="", library=library)))

    def describe(self, schemas: Sequence[Schema], channels: Sequence[Channel]) -> None:
        """Say what is in the file, before the first chunk."""
        self._schemas, self._channels = list(schemas), list(channels)
        self.description = np.frombuffer(_encode(*self._schemas, *self._channels), np.uint8)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record."""
        record = _encode(Metadata(name=name, metadata=dict(values)))
        self._metadata.append(MetadataIndex(offset=self._size, length=len(record), name=name))
        self._write(record)

    def write_chunk(
        self,
        payload: UInt8[np.ndarray, " byte"],
        index: Mapping[int, Shaped[np.ndarray, " message"]],
        *,
        start_time: int,
        end_time: int,
    ) -> None:
        """Write a chunk and its index.

        Args:
            payload: `description`, then the messages.
            index: for each channel with messages in it, an `INDEX_ENTRY` for each of them, in their order.
            start_time: the earliest log time in the chunk, in nanoseconds.
            end_time: the latest.
        """
        compressed = self._compress(payload.data)
        chunk = Chunk(
            compression=self._compression,
            data=compressed,
            message_start_time=start_time,
            message_end_time=end_time,
            uncompressed_crc=zlib.crc32(payload.data),
            uncompressed_size=len(payload),
        )
        chunk_offset = self._size
        self._write(_encode(chunk))
        index_offset, index_offsets = self._size, {}
        for channel, entries in index.items():
            index_offsets[channel] = self._size
            self._write(_encode_index(channel, entries))
            self._counts.add(channel, len(entries))
        self._counts.extend(start_time, end_time)
        self._chunks.append(
            ChunkIndex(
                message_start_time=start_time,
                message_end_time=end_time,
                chunk_start_offset=chunk_offset,
                chunk_length=index_offset - chunk_offset,
                message_index_offsets=index_offsets,
                message_index_length=self._size - index_offset,
                compression=self._compression,
                compressed_size=len(compressed),
                uncompressed_size=len(payload),
            )
        )

    def flush(self) -> None:
        """Hand what has been written to the operating system."""
        self._file.flush()

    def finish(self) -> None:
        """Write the summary and the end of the file."""
        self._write(_encode(DataEnd(self._crc)))
        start = self._size
        groups: list[tuple[Opcode, list[McapRecord]]] = [
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunks]),
            (Opcode.METADATA_INDEX, [*self._metadata]),
        ]
        summary, offsets = b"", []
        for opcode, records in groups:
            if records:
                group = _encode(*records)
                offsets.append(SummaryOffset(opcode, group_start=start + len(summary), group_length=len(group)))
                summary += group
        offset_start = start + len(summary)
        summary += _encode(*offsets)
        footer = _SUMMED_FOOTER.pack(Opcode.FOOTER, 8 + 8 + 4, start, offset_start)
        self._write(summary)
        self._write(_encode(Footer(start, offset_start, summary_crc=zlib.crc32(footer, zlib.crc32(summary)))))
        self._write(MAGIC)
        self.flush()

    def _statistics(self) -> Statistics:
        return Statistics(
            message_count=sum(self._counts.messages.values()),
            schema_count=len(self._schemas),
            channel_count=len(self._channels),
            attachment_count=0,
            metadata_count=len(self._metadata),
            chunk_count=len(self._chunks),
            message_start_time=self._counts.start_time or 0,
            message_end_time=self._counts.end_time,
            channel_message_counts=self._counts.messages,
        )

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        self._size += len(data)
        self._file.write(data)


def _compressor(compression: str) -> Callable[[memoryview], bytes]:
    match compression:
        case "zstd":
            return zstandard.ZstdCompressor(level=_ZSTD_LEVEL).compress
        case "lz4":
            compress: Callable[[memoryview], bytes] = lz4.frame.compress
            return compress
        case _:
            return bytes


def _encode(*records: McapRecord) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return bytes(builder.end())


def _encode_index(channel: int, entries: Shaped[np.ndarray, " message"]) -> bytes:
    body = entries.tobytes()
    return _INDEX_HEADER.pack(Opcode.MESSAGE_INDEX, 2 + 4 + len(body), channel, len(body)) + body
