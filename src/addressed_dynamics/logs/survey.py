"""A walk through any MCAP file, ours or not, that says how far it is sound."""

from __future__ import annotations

import io
from collections import Counter
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import UInt64
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Header
from mcap.writer import MCAP0_MAGIC as MAGIC

from addressed_dynamics.logs.container import MESSAGE_HEADER, Damage, Frame, MessageRun, Source, frames, scan
from addressed_dynamics.logs.decoding import Found
from addressed_dynamics.logs.schema import EPISODE_SCHEMA, TRANSITION_SCHEMA


@dataclass(frozen=True)
class Problem:
    """The first thing that is wrong with a file."""

    message: str
    """What is wrong and what can be done, in one line."""
    offset: int | None
    """Where, in bytes from the start of the file, if it has a place."""


@dataclass
class Survey:
    """What a walk through a file finds, up to its end or the first problem."""

    size: int
    """Bytes."""
    library: str = ""
    """Who wrote the file, in its own words."""
    profile: str = ""
    """What it says about its topics, for instance `ros2`."""
    compression: Counter[str] = field(default_factory=Counter)
    """Number of chunks by their compression; those without any are `none`."""
    found: Found = field(default_factory=Found)
    """Everything but the messages of foreign topics, which may be far larger than the file once decompressed."""
    times: dict[int, list[UInt64[np.ndarray, " message"]]] = field(default_factory=dict)
    """Log times in nanoseconds by channel."""
    problem: Problem | None = None
    """The first thing that is wrong."""

    def add(self, run: MessageRun) -> None:
        """Take up messages."""
        channel = self.found.channels.get(run.channel)
        if channel is None:
            raise Damage(run.offset, f"holds messages of channel {run.channel}, which was not declared before")
        headers = run.messages[:, : MESSAGE_HEADER.itemsize].copy().view(MESSAGE_HEADER)[:, 0]
        self.times.setdefault(run.channel, []).append(headers["log_time"].copy())
        schema = self.found.schemas.get(channel.schema_id)
        if schema and schema.name in {TRANSITION_SCHEMA, EPISODE_SCHEMA}:
            self.found.add(run)


def survey(source: Source) -> Survey:
    """Walk through a file that begins as an MCAP file does; damage is told in the result, never raised."""
    seen = Survey(source.size)
    try:
        for frame in frames(source, len(MAGIC)):
            if frame.opcode == Opcode.HEADER:
                seen.profile, seen.library = _header(frame)
            if frame.opcode == Opcode.CHUNK:
                seen.compression[_compression(frame)] += 1
    except Damage:
        # The walk below meets the same damage, or an earlier one.
        pass
    try:
        for content in scan(source):
            if isinstance(content, MessageRun):
                seen.add(content)
            else:
                seen.found.add(content)
    except Damage as damage:
        seen.problem = Problem(f"byte {damage.offset} {damage.reason}", damage.offset)
    return seen


def _header(frame: Frame) -> tuple[str, str]:
    """Return the profile and the library that the header names."""
    try:
        header = Header.read(ReadDataStream(io.BytesIO(frame.body)))
    except Exception as error:  # mcap's records raise a dozen unrelated types on damaged data
        raise Damage(frame.offset, "is a header that cannot be read") from error
    return header.profile, header.library


def _compression(frame: Frame) -> str:
    """Return the name of a chunk's compression, which follows two times, a size and a checksum."""
    start = 8 + 8 + 8 + 4
    length = int.from_bytes(frame.body[start : start + 4], "little")
    return frame.body[start + 4 : start + 4 + length].decode("ascii", errors="replace")[:20] or "none"
