"""One clock for topics that each have their own rate: an as-of join, the newest value that is not too old."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import polars
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import LogError

MOST_TICKS = 20_000_000
"""Most ticks in a file, eleven days at 20 Hz; a damaged time would ask for any number."""
LONGEST = 1.75
"""A period that is so many times as long as the median is a gap."""
NONE = -1
"""Stands for no message."""


@dataclass(frozen=True)
class TopicTimes:
    """When a topic spoke, and for how long its last word holds."""

    topic: str
    time_ns: Int64[np.ndarray, " message"]
    """Times of its messages, in order; at least one."""
    ends: int
    """When the clock has to stop for lack of newer values."""


def usual_period(periods: Float64[np.ndarray, " period"]) -> float:
    """Return the mean of the periods that are no gaps: the rounding of times, such as 17, 17 and 16 ms, cancels out.

    Args:
        periods: at least one; greater than 0.
    """
    return float(periods[periods < LONGEST * np.median(periods)].mean())


def ticks(where: str, topics: list[TopicTimes], rate_hz: float) -> Int64[np.ndarray, " tick"]:
    """Return the times of the clock: from when all topics have spoken to when the first one ends.

    Raises:
        LogError: the topics never overlap, or their times are so far apart that one must be wrong.
    """
    latest, earliest = max(topics, key=lambda each: each.time_ns[0]), min(topics, key=lambda each: each.ends)
    start, end = int(latest.time_ns[0]), earliest.ends
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
    times = np.asarray(start + np.rint(np.arange(count) * step_ns).astype(np.int64))
    return times[times <= end]


def newest(
    at: Int64[np.ndarray, " tick"], time_ns: Int64[np.ndarray, " message"], tolerance_ns: int | None
) -> Int64[np.ndarray, " tick"]:
    """Return, for each tick, the newest message that is not later than it, nor older than the tolerance; else `NONE`.

    Of several messages with the same time the last one counts.

    Args:
        at: ticks, in order.
        time_ns: times of the messages, in order.
        tolerance_ns: the greatest age; None if any will do.
    """
    left = polars.DataFrame({"time": at}).with_columns(polars.col("time").set_sorted())
    right = polars.DataFrame({"time": time_ns, "message": np.arange(len(time_ns))})
    joined = left.join_asof(
        right.with_columns(polars.col("time").set_sorted()), on="time", strategy="backward", tolerance=tolerance_ns
    )
    return joined["message"].fill_null(NONE).to_numpy().astype(np.int64)


def silences(
    chosen: Int64[np.ndarray, " tick"], time_ns: Int64[np.ndarray, " message"], longest_ns: int
) -> Bool[np.ndarray, " tick"]:
    """Say before which ticks a topic was silent for longer than `longest_ns`.

    Args:
        chosen: the message that counts at each tick; none is `NONE`.
        time_ns: times of the messages.
        longest_ns: the longest silence inside an episode.
    """
    broken = np.zeros(len(chosen), dtype=np.bool_)
    # Between the messages of two ticks there may be others, and the silence is between neighbours.
    long = np.concatenate([[0], np.cumsum(np.diff(time_ns) > longest_ns)])
    broken[1:] = long[chosen[1:]] != long[chosen[:-1]]
    return broken


def _span(topic: TopicTimes) -> str:
    return f"{_seconds(int(topic.time_ns[0]))} to {_seconds(int(topic.time_ns[-1]))} s"


def _seconds(time_ns: int) -> str:
    return f"{time_ns // 10**9}.{time_ns % 10**9 // 10**6:03d}"
