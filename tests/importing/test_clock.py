"""The clock: the as-of join against a naive loop, and the ticks against their definition."""

from itertools import pairwise
from typing import Any

import numpy as np
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.clock import HELD, NONE, Follower, TopicTimes, message_rows, ticks

TIMES = st.lists(st.integers(0, 200), min_size=1, max_size=40).map(sorted)


def newest_by_loop(at: list[int], times: list[int], tolerance: int | None) -> list[int]:
    found = []
    for tick in at:
        best = NONE
        for message, time in enumerate(times):
            if time <= tick and (tolerance is None or tick - time <= tolerance):
                best = message
        found.append(best)
    return found


def cut(data: st.DataObject, rows: np.ndarray) -> list[np.ndarray]:
    places = data.draw(st.lists(st.integers(0, len(rows)), max_size=4))
    return np.split(rows, sorted(places))


def follower(data: st.DataObject, times: list[int], **options: Any) -> Follower:
    messages = np.zeros(len(times), message_rows(2))
    messages["time_ns"] = times
    messages["values"] = np.arange(len(times))[:, None] * [1.0, -1.0]
    return Follower(cut(data, messages), 2, **options)


def all_newest(data: st.DataObject, topic: Follower, at: list[int]) -> np.ndarray:
    """The newest messages, asked for in blocks of ticks."""
    return np.concatenate([topic.at(ticks) for ticks in cut(data, np.array(at)) if len(ticks)])


@given(at=TIMES, times=TIMES, tolerance=st.none() | st.integers(0, 50), data=st.data())
def test_the_newest_message_is_what_a_loop_finds_however_ticks_and_messages_are_cut(
    at: list[int], times: list[int], tolerance: int | None, data: st.DataObject
) -> None:
    topic = follower(data, times, tolerance_ns=tolerance)
    newest = all_newest(data, topic, at)
    expected = newest_by_loop(at, times, tolerance)
    assert newest["number"].tolist() == expected
    found = newest[newest["number"] != NONE]
    assert found["time_ns"].tolist() == [times[number] for number in expected if number != NONE]
    assert found["values"].tolist() == [[number, -number] for number in expected if number != NONE]
    assert topic.used == len(set(expected) - {NONE})
    assert topic.late == expected.count(NONE)


@given(at=TIMES, times=TIMES, tolerance=st.none() | st.integers(0, 50), data=st.data())
def test_the_newest_message_is_that_of_an_as_of_join(
    at: list[int], times: list[int], tolerance: int | None, data: st.DataObject
) -> None:
    left = polars.DataFrame({"time": at}).set_sorted("time")
    right = polars.DataFrame({"time": times, "message": range(len(times))}).set_sorted("time")
    joined = left.join_asof(right, on="time", strategy="backward", tolerance=tolerance)
    newest = all_newest(data, follower(data, times, tolerance_ns=tolerance), at)
    assert newest["number"].tolist() == joined["message"].fill_null(NONE).to_list()


@given(at=TIMES, times=TIMES, data=st.data())
def test_a_message_from_before_holds_until_the_first_one(at: list[int], times: list[int], data: st.DataObject) -> None:
    topic = follower(data, times, held=np.array([0.5, 0.25]))
    newest = all_newest(data, topic, at)
    expected = [HELD if number == NONE else number for number in newest_by_loop(at, times, None)]
    assert newest["number"].tolist() == expected
    assert (newest["values"][newest["number"] == HELD] == [0.5, 0.25]).all()
    assert (topic.used, topic.late) == (len(set(expected) - {HELD}), 0)


@given(times=TIMES, longest=st.integers(1, 50), data=st.data())
def test_a_silence_lies_between_neighbouring_messages(times: list[int], longest: int, data: st.DataObject) -> None:
    at = sorted(data.draw(st.lists(st.integers(times[0], 200), min_size=1)))
    newest = all_newest(data, follower(data, times, longest_ns=longest), at)
    expected = [
        any(times[i + 1] - times[i] > longest for i in range(before, after))
        for before, after in pairwise(newest["number"].tolist())
    ]
    assert (np.diff(newest["silences"]) != 0).tolist() == expected


def topic(name: str, first: int, last: int) -> TopicTimes:
    return TopicTimes(name, first, last, last)


@given(
    start=st.integers(0, 2 * 10**18),
    steps=st.integers(0, 500),
    rate=st.sampled_from([0.5, 3.0, 30.0, 44.1, 1000]),
    size=st.integers(1, 600),
)
def test_the_clock_ticks_at_its_rate_from_the_last_start_to_the_first_end(
    start: int, steps: int, rate: float, size: int
) -> None:
    end = start + round(steps * 1e9 / rate)
    clock = ticks("x.mcap", [topic("/a", start - 5, end), topic("/b", start, end + 7)], rate)
    times = np.concatenate(list(clock.blocks(size)))
    assert times.tolist() == [start + round(i * (1e9 / rate)) for i in range(steps + 1)]
    assert (len(clock), clock.start_ns, clock.last_ns) == (len(times), times[0], times[-1])


def test_topics_that_never_overlap_are_named_with_their_times() -> None:
    with pytest.raises(LogError) as caught:
        ticks("x.mcap", [topic("/a", 10**9, 2 * 10**9), topic("/b", 5 * 10**9, 6 * 10**9)], 10.0)
    assert "/a (1.000 to 2.000 s) and /b (5.000 to 6.000 s) never overlap in time" in str(caught.value)


def test_a_time_that_asks_for_billions_of_ticks_is_refused() -> None:
    with pytest.raises(LogError, match="see whether a time in it is wrong"):
        ticks("x.mcap", [topic("/a", 0, 1_700_000_000 * 10**9)], 100.0)
