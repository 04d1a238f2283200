"""Why errors of long rollouts fall: what stands still or is at a bound."""

import numpy as np
import pytest
from report_examples import evaluation

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.falling import falling, held_states
from addressed_dynamics.evaluation.transitions.records import Falling, FallingPart
from addressed_dynamics.reporting.transitions.rollout_tables import falling_words, rests

DIMENSIONS = (Dimension("position", "m", -1.0, 1.0), Dimension("speed", "m/s", -np.inf, np.inf))
SCALE = np.array([2.0, 1.0])


def cars() -> np.ndarray:
    """Twelve cars that drive for 100 steps; from step 50 on eight stand at a wall, which leaves them a speed."""
    states = np.random.default_rng(0).uniform(-0.9, 0.9, (12, 101, 2))
    states[:8, 50:, 0] = 1.0
    return states


def test_what_stands_at_a_bound_or_does_not_move_is_held() -> None:
    held = held_states(cars(), DIMENSIONS, SCALE)
    assert held[:8, 49:].all()
    assert not held[8:].any()
    assert not held[:, :49].any()
    still = np.tile(np.array([0.3, 5.0]), (1, 4, 1))
    still[0, 2:, 1] = 7.0
    assert held_states(still, DIMENSIONS, SCALE).tolist() == [[True, False, True]]


def test_falling_errors_are_told_apart_by_what_is_held() -> None:
    percent = np.tile(np.linspace(0.1, 10.0, 100), (12, 1))
    percent[:8, 49:] = 0.5
    found = Falling.model_validate(falling(percent, cars(), DIMENSIONS, SCALE))
    assert (found.highest.first_step, found.highest.last_step) == (41, 50)
    assert (found.end.first_step, found.end.last_step) == (91, 100)
    # In the 50th step the eight stand at the wall already.
    assert found.highest.held_share == pytest.approx(8 / 120)
    assert found.end.held_share == pytest.approx(2 / 3)
    assert (found.end.percent, found.end.held_percent) == (0.5, 0.5)
    assert found.end.free_percent == pytest.approx(np.median(percent[8:, 90:]))
    assert rests(found)
    words = falling_words(found)
    assert "from 4.5 % of the range in steps 41 to 50 to 0.50 % in steps 91 to 100. No prediction got better" in words
    assert "67\u202f% of the true states stand still or are at a bound by then (7\u202f% in steps 41 to 50)" in words
    assert "all others are off by 9.6 % (4.5 % in steps 41 to 50)" in words


def test_errors_that_do_not_fall_need_no_words() -> None:
    growing = np.tile(np.linspace(0.1, 10.0, 100), (12, 1))
    assert falling(growing, cars(), DIMENSIONS, SCALE) is None
    # By less than a fifth, and of rollouts too short for ten parts of two steps.
    assert falling(10.0 - 0.15 * growing, cars(), DIMENSIONS, SCALE) is None
    assert falling(growing[:, ::-1][:, :19], cars()[:, :20], DIMENSIONS, SCALE) is None
    assert falling(growing[:, ::-1], cars(), DIMENSIONS, SCALE) is not None


@pytest.mark.parametrize(
    ("then", "end"),
    [
        ((0.3, 0.1, 3.0), (0.3, 0.1, 3.0)),  # as much is held
        ((0.3, 0.1, 3.0), (0.6, 0.1, 1.0)),  # what moves is predicted better, too
        ((0.3, 0.1, 3.0), (0.6, 4.0, 3.0)),  # what is held is predicted worse
        ((0.0, None, 3.0), (0.0, None, 1.0)),  # nothing is held
    ],
)
def test_rest_is_no_excuse_where_it_explains_nothing(
    then: tuple[float, float | None, float], end: tuple[float, float | None, float]
) -> None:
    parts = [
        FallingPart(first_step=1, last_step=10, percent=percent, held_share=share, held_percent=held, free_percent=free)
        for percent, (share, held, free) in ((2.0, then), (1.0, end))
    ]
    found = Falling(highest=parts[0], end=parts[1])
    assert not rests(found)
    assert "That the world comes to rest does not explain it" in falling_words(found)


def test_results_of_earlier_versions_say_nothing_of_it() -> None:
    assert evaluation().falling is None
    assert evaluation().repeats is None
