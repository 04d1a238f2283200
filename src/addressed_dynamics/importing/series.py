"""What one topic of a recording says of the signals that come from it."""

from __future__ import annotations

import struct
from array import array
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64, Int64, Shaped
from mcap.records import Channel, Schema

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.arrays import Arrays
from addressed_dynamics.importing.clock import BEFORE, message_rows
from addressed_dynamics.importing.decoding import ZSTANDARD, Decode, decoder_for, reason, unpacked
from addressed_dynamics.importing.median import median
from addressed_dynamics.importing.paths import FieldPath, Label, MissingField, listed_fields, look_up, shown
from addressed_dynamics.importing.samples import usable
from addressed_dynamics.importing.signals import Signal
from addressed_dynamics.importing.spool import BLOCK_ROWS, Spool
from addressed_dynamics.importing.stamps import own_time
from addressed_dynamics.logs.container import MessageRun

Clock = Literal["log", "publish", "header"]
"""Which time of a message counts: when it was logged, when it was published, or the one that it says of itself."""
LATEST = 2**63 - 1
"""Latest time that fits our clock, in nanoseconds since 1970: in the year 2262."""

_HEADER = struct.Struct("<BQHIQQ")
# Opcode, length, channel, sequence, log time and publish time: `MESSAGE_HEADER` for one message at a time.


@dataclass
class TopicSeries:
    """The messages of a topic in a part of a recording; those with a value that is not finite are only counted."""

    topic: str
    signals: tuple[int, ...]
    """Which signals their values are, by their place in `Signals.all`."""
    rows: Spool
    """Where they are, as `message_rows`, in the order of the file."""
    start: int = 0
    """The first row of this part."""
    finite: int = 0
    """Rows of this part."""
    not_finite: int = 0
    backwards: int = 0
    """Messages that stood in the file after a later one."""
    farthest_back_ns: int = 0
    """How much later, at most."""
    first_ns: int = LATEST
    """The earliest time; that of `held` if there is one."""
    last_ns: int = BEFORE
    """The latest time; that of `held` if there is no other."""
    last: Float64[np.ndarray, " signal"] | None = None
    """The values of the last message in order of time."""
    held: Float64[np.ndarray, " signal"] | None = None
    """The values of the last message of the parts before, if it holds on."""
    _latest_ns: int = BEFORE

    def __post_init__(self) -> None:
        self.spoken = np.zeros(len(self.signals), dtype=np.bool_)
        """The signals that have a finite value in some message."""

    def add(self, time_ns: Int64[np.ndarray, " message"], values: Float64[np.ndarray, "message signal"]) -> None:
        """Take up messages in the order of the file, at least one."""
        latest = np.maximum.accumulate(np.append(self._latest_ns, time_ns))
        behind = latest[1:] - time_ns
        self._latest_ns = int(latest[-1])
        self.backwards += int((behind > 0).sum())
        self.farthest_back_ns = max(self.farthest_back_ns, int(behind.max()))
        self.spoken |= np.isfinite(values).any(axis=0)
        kept = usable(values)
        self.not_finite += int((~kept).sum())
        if kept.any():
            rows = np.empty(int(kept.sum()), message_rows(len(self.signals)))
            rows["time_ns"], rows["values"] = time_ns[kept], values[kept]
            self._append(rows)

    def hold(self, last: Float64[np.ndarray, " signal"]) -> None:
        """Let the last message of the parts before, which has these values, hold at the beginning of this one."""
        self.held, self.first_ns = last, BEFORE
        self.last = last if self.last is None else self.last

    def messages(self) -> Iterator[Shaped[np.ndarray, " message"]]:
        """Yield the messages in order of time, as `message_rows`; of those with the same time, in that of the file."""
        blocks = self.rows.blocks(self.start, self.start + self.finite)
        return _in_order(blocks, self.farthest_back_ns) if self.backwards else blocks

    @property
    def rate_hz(self) -> float | None:
        """Messages a second, from the median of the times between them; None with fewer than two times."""
        period_ns = median(self._periods)
        return None if period_ns is None else 1e9 / period_ns

    def _append(self, rows: Shaped[np.ndarray, " message"]) -> None:
        self.rows.append(rows)
        self.finite += len(rows)
        latest = int(rows["time_ns"].max())
        if latest >= self.last_ns:
            self.last_ns = latest
            self.last = rows["values"][np.flatnonzero(rows["time_ns"] == latest)[-1]].copy()
        self.first_ns = min(self.first_ns, int(rows["time_ns"].min()))

    def _periods(self) -> Iterator[Int64[np.ndarray, " period"]]:
        last_ns = None
        for block in self.messages():
            if len(block):
                periods = np.diff(block["time_ns"], prepend=block["time_ns"][0] if last_ns is None else last_ns)
                last_ns = block["time_ns"][-1]
                yield periods[periods > 0]


def _in_order(
    blocks: Iterable[Shaped[np.ndarray, " message"]], farthest_back_ns: int
) -> Iterator[Shaped[np.ndarray, " message"]]:
    """Sort messages by time, in memory for a block and for those that may still come before what is waiting."""
    waiting: Shaped[np.ndarray, " message"] | None = None
    for block in blocks:
        waiting = block if waiting is None else np.concatenate([waiting, block])
        waiting = waiting[np.argsort(waiting["time_ns"], kind="stable")]
        ready = int(np.searchsorted(waiting["time_ns"], waiting["time_ns"][-1] - farthest_back_ns, side="right"))
        yield waiting[:ready]
        waiting = waiting[ready:]
    if waiting is not None:
        yield waiting


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
    """Decodes the messages of a topic and keeps the numbers that are wanted, on disk if there are many.

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
        self._time_ns, self._values = array("q"), array("d")
        self._part, self._series = 0, dict[int, TopicSeries]()
        self._rows: Spool | None = None
        self._stamped = False
        self._in_file = 0
        self.encodings = set[str]()
        """How its messages are encoded."""
        self.decompressed = 0
        """Messages that were compressed by themselves."""

    def __len__(self) -> int:
        return len(self._time_ns) + sum(each.finite + each.not_finite for each in self._series.values())

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
            if self._turns.active and (part := self._turns.part(stamp)) != self._part:
                self._set_aside()
                self._part = part
            self._arrays.begin(f"message {self._in_file} of {self._where}")
            for _, path, signal in self._wanted:
                self._values.append(self._number(stamp, decoded, path, signal))
            self._time_ns.append(stamp)
            self._in_file += 1
        if len(self._time_ns) >= BLOCK_ROWS:
            self._set_aside()

    def series(self) -> dict[int, TopicSeries]:
        """Return what was taken up, of which there is some, for each part of the recording that has some."""
        self._set_aside()
        if self._clock == "header" and not self._stamped:
            message = (
                f"{self._where}: all messages of topic {self._topic} say that their time is 0, which nobody set; "
                "give the topic another 'time' under 'topics'"
            )
            raise LogError(message)
        self._check_names()
        return self._series

    def _check_names(self) -> None:
        """Refuse a name that stands beside no array."""
        spoken = np.any([each.spoken for each in self._series.values()], axis=0)
        for (_, path, _), found in zip(self._wanted, spoken, strict=True):
            named = [step.name for step in path.steps if isinstance(step, Label)]
            if not found and not set(named) <= set(self._arrays.seen):
                message = (
                    f"{self._where}: topic {self._topic} has no field '{shown(path.steps).lstrip('.')}'; the names "
                    f"beside the array are: {', '.join(self._arrays.seen)}"
                )
                raise LogError(message)

    def _set_aside(self) -> None:
        if not self._time_ns:
            return
        time_ns = np.array(self._time_ns, dtype=np.int64)
        values = np.array(self._values, dtype=np.float64).reshape(len(time_ns), len(self._wanted))
        self._time_ns, self._values = array("q"), array("d")
        self._stamped |= bool(time_ns.any())
        if self._rows is None:
            self._rows = Spool(message_rows(len(self._wanted)))
        if self._part not in self._series:
            signals = tuple(place for place, _, _ in self._wanted)
            self._series[self._part] = TopicSeries(self._topic, signals, self._rows, start=len(self._rows))
        self._series[self._part].add(time_ns, values)

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
