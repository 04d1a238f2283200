"""What one topic of a recording says of the signals that come from it."""

from __future__ import annotations

import struct
from array import array
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64, Int64
from mcap.records import Channel, Schema

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.arrays import Arrays
from addressed_dynamics.importing.decoding import ZSTANDARD, Decode, decoder_for, reason, unpacked
from addressed_dynamics.importing.paths import FieldPath, Label, MissingField, listed_fields, look_up, shown
from addressed_dynamics.importing.signals import Signal
from addressed_dynamics.importing.stamps import own_time
from addressed_dynamics.logs.container import MessageRun

Clock = Literal["log", "publish", "header"]
"""Which time of a message counts: when it was logged, when it was published, or the one that it says of itself."""
LATEST = 2**63 - 1
"""Latest time that fits our clock, in nanoseconds since 1970: in the year 2262."""

_HEADER = struct.Struct("<BQHIQQ")
# Opcode, length, channel, sequence, log time and publish time: `MESSAGE_HEADER` for one message at a time.


@dataclass(frozen=True)
class TopicSeries:
    """The values of a topic's signals in a part of a recording, in order of time."""

    topic: str
    signals: tuple[int, ...]
    """Which signals these are, by their place in `Signals.all`."""
    time_ns: Int64[np.ndarray, " message"]
    values: Float64[np.ndarray, "message signal"]
    backwards: int
    """Messages that stood in the file after a later one."""
    farthest_back_ns: int
    """How much later, at most."""

    @property
    def rate_hz(self) -> float | None:
        """Messages a second, from the median of the times between them; None with fewer than two times."""
        periods = np.diff(self.time_ns)
        periods = periods[periods > 0]
        return 1e9 / float(np.median(periods)) if len(periods) else None


class Turns:
    """Numbers the parts of a recording: another one begins where time goes back by more than the tolerance.

    Args:
        tolerance_ns: how far time may go back within a part; None if there is only one part.
    """

    def __init__(self, tolerance_ns: int | None) -> None:
        self._tolerance_ns = tolerance_ns
        self.active = tolerance_ns is not None
        """Whether there may be more than one part."""
        self._latest: int | None = None
        self._part = 0

    def part(self, time_ns: int) -> int:
        """Return the part of the next message in the order of the file, whichever topic it is of."""
        if self._tolerance_ns is None:
            return 0
        if self._latest is not None and time_ns < self._latest - self._tolerance_ns:
            self._part += 1
            self._latest = time_ns
        self._latest = time_ns if self._latest is None else max(self._latest, time_ns)
        return self._part


class TopicReader:
    """Decodes the messages of a topic and keeps the numbers that are wanted, eight bytes each.

    Args:
        topic: the topic.
        clock: which time of a message counts.
        turns: numbers the parts of the recording.
        agreement: what the files before this recording looked like.
    """

    def __init__(self, topic: str, *, clock: Clock, turns: Turns, agreement: Agreement) -> None:
        self._where, self._topic, self._clock, self._turns = "", topic, clock, turns
        self._arrays = Arrays(topic, agreement)
        self._wanted: list[tuple[int, FieldPath, Signal]] = []
        self._decoders: dict[int, Decode] = {}
        self._time_ns, self._parts, self._values = array("q"), array("q"), array("d")
        self._in_file = 0
        self.encodings = set[str]()
        """How its messages are encoded."""
        self.decompressed = 0
        """Messages that were compressed by themselves."""

    def __len__(self) -> int:
        return len(self._time_ns)

    @property
    def topic(self) -> str:
        """The topic."""
        return self._topic

    @property
    def reordered(self) -> int:
        """Messages whose names stood in another order than in the first one."""
        return self._arrays.reordered

    @property
    def names(self) -> dict[str, list[str]]:
        """The names beside arrays that were followed, by the path of their array."""
        return self._arrays.names

    def want(self, place: int, path: FieldPath, signal: Signal) -> None:
        """Ask for one more signal, which is at `place` in `Signals.all`."""
        self._wanted.append((place, path, signal))

    def begin(self, where: str) -> None:
        """Begin with the next file of the recording, whose name is for errors."""
        self._where, self._in_file = where, 0
        self._decoders.clear()

    def add(self, channel: Channel, schema: Schema | None, run: MessageRun) -> None:
        """Take up messages of the topic.

        Raises:
            LogError: a message cannot be decoded or lacks a field, or it does not agree with those before.
        """
        decode = self._decoders.get(channel.id) or self._new_decoder(channel, schema)
        data, size = run.messages.tobytes(), run.messages.shape[1]
        for start in range(0, len(data), size):
            *_, log_time, publish_time = _HEADER.unpack_from(data, start)
            stamp = publish_time if self._clock == "publish" else log_time
            payload = data[start + _HEADER.size : start + size]
            try:
                if payload[:4] == ZSTANDARD:
                    payload = unpacked(payload)
                    self.decompressed += 1
                    self.encodings.add(f"{channel.message_encoding}, each message compressed by zstd")
                decoded = decode(payload)
            except Exception as error:  # the decoders raise a dozen unrelated types on damaged data
                what = f"cannot be decoded: {reason(error)}; record it again, or ask the program that wrote it"
                raise self._refused(stamp, what) from error
            if self._clock == "header":
                stamp = self._own_time(stamp, decoded)
            if not 0 <= stamp <= LATEST:
                raise self._refused(stamp, "is before 1970 or after the year 2262; choose another 'time' for its topic")
            self._arrays.begin(f"message {self._in_file} of {self._where}")
            for _, path, signal in self._wanted:
                self._values.append(self._number(stamp, decoded, path, signal))
            self._time_ns.append(stamp)
            if self._turns.active:
                self._parts.append(self._turns.part(stamp))
            self._in_file += 1

    def series(self) -> dict[int, TopicSeries]:
        """Return what was taken up, of which there is some, for each part of the recording that has some."""
        # No copies: there may be many millions of messages.
        time_ns, parts = np.frombuffer(self._time_ns, dtype=np.int64), np.frombuffer(self._parts, dtype=np.int64)
        values = np.frombuffer(self._values, dtype=np.float64).reshape(len(time_ns), len(self._wanted))
        if self._clock == "header" and not time_ns.any():
            message = (
                f"{self._where}: all messages of topic {self._topic} say that their time is 0, which nobody set; "
                "give the topic another 'time' under 'topics'"
            )
            raise LogError(message)
        self._check_names(values)
        if not self._turns.active:
            return {0: self._series(time_ns, values)}
        return {int(part): self._series(time_ns[parts == part], values[parts == part]) for part in np.unique(parts)}

    def _check_names(self, values: Float64[np.ndarray, "message signal"]) -> None:
        """Refuse a name that stands beside no array."""
        for (_, path, _), column in zip(self._wanted, values.T, strict=True):
            named = [step.name for step in path.steps if isinstance(step, Label)]
            if not np.isfinite(column).any() and not set(named) <= set(self._arrays.seen):
                message = (
                    f"{self._where}: topic {self._topic} has no field '{shown(path.steps).lstrip('.')}'; the names "
                    f"beside the array are: {', '.join(self._arrays.seen)}"
                )
                raise LogError(message)

    def _series(
        self, time_ns: Int64[np.ndarray, " message"], values: Float64[np.ndarray, "message signal"]
    ) -> TopicSeries:
        behind = np.maximum.accumulate(time_ns) - time_ns
        if behind.any():
            order = np.argsort(time_ns, kind="stable")
            time_ns, values = time_ns[order], values[order]
        return TopicSeries(
            topic=self._topic,
            signals=tuple(place for place, _, _ in self._wanted),
            time_ns=time_ns,
            values=values,
            backwards=int((behind > 0).sum()),
            farthest_back_ns=int(behind.max()),
        )

    def _new_decoder(self, channel: Channel, schema: Schema | None) -> Decode:
        self.encodings.add(channel.message_encoding)
        self._decoders[channel.id] = decoder_for(self._where, channel, schema)
        return self._decoders[channel.id]

    def _own_time(self, stamp: int, decoded: Any) -> int:
        try:
            return own_time(decoded)
        except ValueError as error:
            raise self._refused(stamp, str(error)) from error

    def _number(self, stamp: int, decoded: Any, path: FieldPath, signal: Signal) -> float:
        try:
            return signal.number(look_up(decoded, path.steps, self._arrays.place))
        except MissingField as error:
            what = f"has no field '{shown(path.steps).lstrip('.')}'; its fields are: {listed_fields(decoded)}"
            raise self._refused(stamp, what) from error
        except (TypeError, ValueError, OverflowError) as error:
            what = f"has a field '{shown(path.steps).lstrip('.')}' that cannot be used: {reason(error)}"
            raise self._refused(stamp, what) from error

    def _refused(self, stamp: int, what: str) -> LogError:
        return LogError(f"{self._where}: message {self._in_file} of topic {self._topic} (time {stamp} ns) {what}")
