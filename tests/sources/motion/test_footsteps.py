from pathlib import Path

import numpy as np
import pytest

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.sources.motion.footsteps import Cycle, parse_cycles, rows_of, within

FILE = Path("clip_footsteps.txt")


def _cycles(text: str) -> list[tuple[int, int, int]]:
    return [(each.index, each.first, each.last) for each in parse_cycles(FILE, text.splitlines(), step=2)]


def test_a_cycle_goes_from_a_line_to_the_next() -> None:
    assert _cycles("199 237\n289 335\n378 421\n") == [(0, 99, 144), (1, 144, 189)]


def test_no_cycle_begins_or_ends_at_a_marked_line_but_all_are_counted() -> None:
    assert _cycles("10 20\n30 40 *\n50 60\n70 80\n90 95*\n100 110\n120 130") == [(2, 25, 35), (5, 50, 60)]


def test_no_cycle_ends_at_a_line_of_one_number() -> None:
    assert _cycles("10 20\n30 40\n50\n") == [(0, 5, 15)]


def test_blank_lines_end_cycles() -> None:
    assert _cycles("10 20\n\n30 40\n50 60\n\n") == [(2, 15, 25)]
    assert _cycles("") == _cycles("10 20") == []


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("10 20\n30 40\nheel 60", r"clip_footsteps\.txt, line 3: expected the number of a frame, but found 'heel'"),
        ("1.5 20\n30 40", r"line 1: expected the number of a frame, but found '1\.5'"),
        ("10 20\n11 40", r"line 2: expected a frame after 10, but found 11"),
        ("50 60\n30 40", r"line 2: expected a frame after 50, but found 30"),
    ],
)
def test_footsteps_that_make_no_sense_are_refused_with_their_line(text: str, message: str) -> None:
    with pytest.raises(MotionError, match=message):
        _cycles(text)


def test_only_cycles_with_a_second_on_both_sides_are_used() -> None:
    assert [each.index for each in within([Cycle(0, 59, 90), Cycle(1, 60, 138), Cycle(2, 60, 139)], frames=200)] == [1]


def test_a_frame_between_cycles_is_in_both() -> None:
    rows = rows_of([Cycle(3, 60, 62), Cycle(4, 62, 63)])
    np.testing.assert_array_equal(rows.frame, [60, 61, 62, 62, 63])
    np.testing.assert_array_equal(rows.cycle, [3, 3, 3, 4, 4])
    np.testing.assert_array_equal(rows.first, [True, False, False, True, False])
    np.testing.assert_array_equal(rows.last, [False, False, True, False, True])
    assert len(rows_of([]).frame) == len(rows_of([]).first) == 0
