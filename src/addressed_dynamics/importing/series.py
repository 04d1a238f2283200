"""What one topic of a log says of the signals that come from it."""

from __future__ import annotations

import hashlib
import struct
from array import array
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64, Int64
from mcap.records import Channel, Schema

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.decoding import Decode, decoder_for, reason
from addressed_dynamics.importing.paths import FieldPath, MissingField, Step, listed_fields, look_up, shown
from addressed_dynamics.importing.signals import Signal
from addressed_dynamics.logs.container import MessageRun

LATEST = 2**63 - 1
"""Latest time that fits our clock, in nanoseconds since 1970: in the year 2262."""

_HEADER = struct.Struct("<BQHIQQ")
# Opcode, length, channel, sequence, log time and publish time: `MESSAGE_HEADER` for one message at a time.


@dataclass(frozen=True)
class TopicSeries:
    """The values of a topic's signals, in order of time."""

    topic: str
    signals: tuple[int, ...]
    """Which signals these are, by their place in `Signals.all`."""
    time_ns: Int64[np.ndarray, " message"]
    values: Float64[np.ndarray, "message signal"]
    backwards: int
    """Messages that stood in the file after a later one."""
    farthest_back_ns: int
    """How much later, at most."""
    encodings: tuple[str, ...]
    """How its messages are encoded."""


class TopicReader:
    """Decodes the messages of a topic and keeps the numbers that are wanted, eight bytes each.

    Args:
        where: the file, for errors.
        topic: the topic.
        time: which time of a message counts.
        agreement: what the files before this one looked like.
    """

    def __init__(self, where: str, topic: str, *, time: Literal["log", "publish"], agreement: Agreement) -> None:
        self._where, self._topic, self._time, self._agreement = where, topic, time, agreement
        self._wanted: list[tuple[int, FieldPath, Signal]] = []
        self._decoders: dict[int, Decode] = {}
        self._encodings: set[str] = set()
        self._lengths: dict[tuple[Step, ...], int] = {}
        self._time_ns = array("q")
        self._values = array("d")

    def __len__(self) -> int:
        return len(self._time_ns)

    def want(self, place: int, path: FieldPath, signal: Signal) -> None:
        """Ask for one more signal, which is at `place` in `Signals.all`."""
        self._wanted.append((place, path, signal))

    def add(self, channel: Channel, schema: Schema | None, run: MessageRun) -> None:
        """Take up messages of the topic.

        Raises:
            LogError: a message cannot be decoded or lacks a field, or it does not agree with those before.
        """
        decode = self._decoders.get(channel.id) or self._new_decoder(channel, schema)
        data, size = run.messages.tobytes(), run.messages.shape[1]
        for start in range(0, len(data), size):
            *_, log_time, publish_time = _HEADER.unpack_from(data, start)
            stamp = log_time if self._time == "log" else publish_time
            if stamp > LATEST:
                raise self._refused(stamp, "is later than the year 2262; its time is damaged, so record it again")
            try:
                decoded = decode(data[start + _HEADER.size : start + size])
            except Exception as error:  # the decoders raise a dozen unrelated types on damaged data
                what = f"cannot be decoded ({reason(error)}); record it again, or ask the program that wrote it"
                raise self._refused(stamp, what) from error
            for _, path, signal in self._wanted:
                self._values.append(self._number(stamp, decoded, path, signal))
            self._time_ns.append(stamp)

    def series(self) -> TopicSeries:
        """Return what was taken up, of which there is some."""
        time_ns = np.array(self._time_ns, dtype=np.int64)
        values = np.array(self._values, dtype=np.float64).reshape(len(time_ns), len(self._wanted))
        order = np.argsort(time_ns, kind="stable")
        behind = np.maximum.accumulate(time_ns) - time_ns
        return TopicSeries(
            topic=self._topic,
            signals=tuple(place for place, _, _ in self._wanted),
            time_ns=time_ns[order],
            values=values[order],
            backwards=int((behind > 0).sum()),
            farthest_back_ns=int(behind.max()),
            encodings=tuple(sorted(self._encodings)),
        )

    def _new_decoder(self, channel: Channel, schema: Schema | None) -> Decode:
        what = f"the schema of topic {self._topic} in '{channel.message_encoding}'"
        self._agreement.check(what, _identity(schema), self._where)
        self._encodings.add(channel.message_encoding)
        self._decoders[channel.id] = decoder_for(self._where, channel, schema)
        return self._decoders[channel.id]

    def _number(self, stamp: int, decoded: Any, path: FieldPath, signal: Signal) -> float:
        try:
            return signal.number(look_up(decoded, path.steps, self._check_length))
        except MissingField as error:
            what = f"has no field '{shown(path.steps).lstrip('.')}'; its fields are: {listed_fields(decoded)}"
            raise self._refused(stamp, what) from error
        except (TypeError, ValueError, OverflowError) as error:
            what = f"has a field '{shown(path.steps).lstrip('.')}' that cannot be used: {reason(error)}"
            raise self._refused(stamp, what) from error

    def _check_length(self, steps: tuple[Step, ...], length: int) -> None:
        if self._lengths.get(steps) != length:
            self._agreement.check(f"the length of the array {self._topic}{shown(steps)}", length, self._where)
            self._lengths[steps] = length

    def _refused(self, stamp: int, what: str) -> LogError:
        return LogError(f"{self._where}: message {len(self)} of topic {self._topic} (time {stamp} ns) {what}")


def _identity(schema: Schema | None) -> str:
    if schema is None:
        return "absent"
    return f"{schema.name or 'nameless'} ({hashlib.sha256(schema.data).hexdigest()[:8]})"
