"""One clock for topics that each have their own rate: an as-of join, the newest value that is not too old.

Ticks and messages are gone through in blocks, so that neither needs to be in memory.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64, Shaped

from addressed_dynamics.base.errors import LogError

MOST_TICKS = 20_000_000
"""Most ticks in a file, eleven days at 20 Hz; a damaged time would ask for any number."""
LONGEST = 1.75
"""A period that is so many times as long as the median is a gap."""
NONE = -1
"""Stands for no message."""
HELD = -2
"""Stands for a message from before the first one."""
BEFORE = np.iinfo(np.int64).min // 2
"""The time of such a message; a long way from where a time could overflow."""


@dataclass(frozen=True)
class TopicTimes:
    """When a topic spoke, and for how long its last word holds."""

    topic: str
    first_ns: int
    """The time of its first message."""
    last_ns: int
    ends: int
    """When the clock has to stop for lack of newer values."""


def usual_period(periods: Float64[np.ndarray, " period"]) -> float:
    """Return the mean of the periods that are no gaps: the rounding of times, such as 17, 17 and 16 ms, cancels out.

    Args:
        periods: at least one; greater than 0.
    """
    return float(periods[periods < LONGEST * np.median(periods)].mean())


@dataclass(frozen=True)
class Ticks:
    """The times of a clock."""

    start_ns: int
    step_ns: float
    count: int

    def __len__(self) -> int:
        return self.count

    @property
    def last_ns(self) -> int:
        """The time of the last one."""
        return int(self.times(self.count - 1, self.count)[0])

    def times(self, first: int, stop: int) -> Int64[np.ndarray, " tick"]:
        """Return the times of the ticks from number `first` to `stop`."""
        return np.asarray(self.start_ns + np.rint(np.arange(first, stop) * self.step_ns).astype(np.int64))

    def blocks(self, size: int) -> Iterator[Int64[np.ndarray, " tick"]]:
        """Yield the times of all ticks, so many at once."""
        for first in range(0, self.count, size):
            yield self.times(first, min(first + size, self.count))


def ticks(where: str, topics: list[TopicTimes], rate_hz: float) -> Ticks:
    """Return the clock: from when all topics have spoken to when the first one ends.

    Raises:
        LogError: the topics never overlap, or their times are so far apart that one must be wrong.
    """
    latest, earliest = max(topics, key=lambda each: each.first_ns), min(topics, key=lambda each: each.ends)
    start, end = latest.first_ns, earliest.ends
    if start > end:
        message = (
            f"{where}: the topics {earliest.topic} ({_span(earliest)}) and {latest.topic} ({_span(latest)}) never "
            "overlap in time; a value that is sent once needs 'hold: true' under 'topics'; else see whether they were "
            "stamped by different clocks"
        )
        raise LogError(message)
    step_ns = 1e9 / rate_hz
    count = int((end - start) / step_ns) + 2  # one too many, or rounding may lose the last
    if count > MOST_TICKS:
        message = (
            f"{where}: from {_seconds(start)} to {_seconds(end)} s there are {count} ticks at {rate_hz:g} Hz, but at "
            f"most {MOST_TICKS} are made; see whether a time in it is wrong, or cut the file"
        )
        raise LogError(message)
    late = Ticks(start, step_ns, count).times(max(count - 3, 0), count) > end
    return Ticks(start, step_ns, count - int(late.sum()))


def message_rows(signals: int) -> np.dtype[Any]:
    """Return the fields of messages: their time, and the values of so many signals."""
    return np.dtype([("time_ns", np.int64), ("values", np.float64, (signals,))])


def newest_rows(signals: int) -> np.dtype[Any]:
    """Return the fields of the newest messages at some ticks: the same, their number, and the silences before them."""
    return np.dtype([*message_rows(signals).descr, ("number", np.int64), ("silences", np.int64)])


class Follower:
    """Goes along the ticks, and knows the newest message of a topic that is not too old.

    Of several messages with the same time the last one counts.

    Args:
        blocks: the messages in order of time, as `message_rows`.
        signals: how many values each of them has.
        held: the values of a message from before the first one.
        tolerance_ns: the greatest age; None if any will do.
        longest_ns: the longest time between two messages that is no silence.
    """

    def __init__(
        self,
        blocks: Iterable[Shaped[np.ndarray, " message"]],
        signals: int,
        *,
        held: Float64[np.ndarray, " signal"] | None = None,
        tolerance_ns: int | None = None,
        longest_ns: int | None = None,
    ) -> None:
        self.used = 0
        """Messages that were the newest at some tick; one that was held from before is none."""
        self.late = 0
        """Ticks without a message."""
        self._row = newest_rows(signals)
        self._tolerance_ns, self._longest_ns = tolerance_ns, longest_ns
        self._blocks = self._numbered(blocks)
        self._block = next(self._blocks, None)
        self._newest = np.zeros(1, self._row)
        self._newest["number"], self._newest["values"] = (NONE, np.nan) if held is None else (HELD, held)
        self._last_used = NONE

    def at(self, ticks: Int64[np.ndarray, " tick"]) -> Shaped[np.ndarray, " tick"]:
        """Return the newest message at each of the next ticks, as `newest_rows`; the number of none is `NONE`.

        Args:
            ticks: their times, in order; at least one.
        """
        found = np.repeat(self._newest, len(ticks))
        while self._block is not None and self._block["time_ns"][0] <= ticks[-1]:
            times = self._block["time_ns"]
            first = int(np.searchsorted(ticks, times[0]))
            found[first:] = self._block[np.searchsorted(times, ticks[first:], side="right") - 1]
            if times[-1] > ticks[-1]:
                break
            self._block = next(self._blocks, None)
        self._newest = found[-1:].copy()
        if self._tolerance_ns is not None:
            found["number"][ticks - found["time_ns"] > self._tolerance_ns] = NONE
        self._count(found["number"])
        return found

    def _numbered(self, blocks: Iterable[Shaped[np.ndarray, " message"]]) -> Iterator[Shaped[np.ndarray, " message"]]:
        number, silences, last_ns = 0, 0, None
        for block in blocks:
            if not len(block):
                continue
            rows = np.empty(len(block), self._row)
            rows["time_ns"], rows["values"] = block["time_ns"], block["values"]
            rows["number"] = np.arange(number, number + len(block))
            rows["silences"] = silences
            if self._longest_ns is not None:
                waits = np.diff(block["time_ns"], prepend=block["time_ns"][0] if last_ns is None else last_ns)
                rows["silences"] += np.cumsum(waits > self._longest_ns)
            number, silences, last_ns = number + len(block), rows["silences"][-1], block["time_ns"][-1]
            yield rows

    def _count(self, numbers: Int64[np.ndarray, " tick"]) -> None:
        self.late += int((numbers == NONE).sum())
        own = numbers[numbers >= 0]
        if len(own):
            self.used += int(np.count_nonzero(np.diff(own, prepend=self._last_used)))
            self._last_used = int(own[-1])


def _span(topic: TopicTimes) -> str:
    return f"{_seconds(topic.first_ns)} to {_seconds(topic.last_ns)} s"


def _seconds(time_ns: int) -> str:
    return f"{time_ns // 10**9}.{time_ns % 10**9 // 10**6:03d}"
