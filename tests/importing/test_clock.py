"""The clock: the as-of join against a naive loop, and the ticks against their definition."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.clock import NONE, TopicTimes, newest, silences, ticks

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


@given(at=TIMES, times=TIMES, tolerance=st.none() | st.integers(0, 50))
def test_the_newest_message_is_what_a_loop_finds(at: list[int], times: list[int], tolerance: int | None) -> None:
    assert newest(np.array(at), np.array(times), tolerance).tolist() == newest_by_loop(at, times, tolerance)


@given(times=TIMES, longest=st.integers(1, 50), data=st.data())
def test_a_silence_lies_between_neighbouring_messages(times: list[int], longest: int, data: st.DataObject) -> None:
    chosen = sorted(data.draw(st.lists(st.integers(0, len(times) - 1), min_size=1)))
    expected = [False] + [
        any(times[i + 1] - times[i] > longest for i in range(before, after)) for before, after in pairwise(chosen)
    ]
    assert silences(np.array(chosen), np.array(times), longest).tolist() == expected


def topic(name: str, first: int, last: int) -> TopicTimes:
    return TopicTimes(name, np.array([first, last]), last)


@given(start=st.integers(0, 2 * 10**18), steps=st.integers(0, 500), rate=st.sampled_from([0.5, 3.0, 30.0, 44.1, 1000]))
def test_the_clock_ticks_at_its_rate_from_the_last_start_to_the_first_end(start: int, steps: int, rate: float) -> None:
    end = start + round(steps * 1e9 / rate)
    times = ticks("x.mcap", [topic("/a", start - 5, end), topic("/b", start, end + 7)], rate)
    assert times.tolist() == [start + round(i * (1e9 / rate)) for i in range(steps + 1)]


def test_topics_that_never_overlap_are_named_with_their_times() -> None:
    with pytest.raises(LogError) as caught:
        ticks("x.mcap", [topic("/a", 10**9, 2 * 10**9), topic("/b", 5 * 10**9, 6 * 10**9)], 10.0)
    assert "/a (1.000 to 2.000 s) and /b (5.000 to 6.000 s) never overlap in time" in str(caught.value)


def test_a_time_that_asks_for_billions_of_ticks_is_refused() -> None:
    with pytest.raises(LogError, match="see whether a time in it is wrong"):
        ticks("x.mcap", [topic("/a", 0, 1_700_000_000 * 10**9)], 100.0)
