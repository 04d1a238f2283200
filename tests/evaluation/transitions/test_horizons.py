"""How long rollouts hold, and errors in % of the range."""

import numpy as np
import pytest
from learning import drive, untrained_model

from addressed_dynamics.evaluation.transitions.horizons import (
    median_course,
    one_step_percent,
    percent_of_range,
    steps_until_lost,
)
from addressed_dynamics.evaluation.transitions.records import Horizon
from addressed_dynamics.evaluation.transitions.suite import measure_horizon
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts

SCALE = np.array([2.0, 10.0])


def test_errors_are_root_mean_squares_of_shares_of_the_range() -> None:
    squared = np.array([[0.04, 0.0], [0.04, 1.0]])
    np.testing.assert_allclose(percent_of_range(squared, SCALE), [10 / np.sqrt(2), 10.0])


def test_angles_do_not_count_beside_the_dimensions_that_give_them() -> None:
    dimensions = [{"squared": {"mean": each}} for each in (0.04, 1.0, 77.0)]
    assert one_step_percent(dimensions, SCALE) == pytest.approx(10.0)


def test_a_rollout_is_lost_in_the_step_in_which_the_median_error_reaches_a_tenth_of_the_range() -> None:
    growing = np.arange(1, 31) * 0.01  # share of the range
    squared = (np.array([0.5, 1.0, 5.0])[:, None] * growing)[..., None] ** 2 * SCALE**2
    assert steps_until_lost(median_course(squared + 1e-12, SCALE)) == 10
    assert steps_until_lost(median_course(squared[:1, :19], SCALE)) is None


def test_the_median_course_is_of_root_mean_squares_in_per_cent_and_of_the_median_rollout_at_each_step() -> None:
    squared = np.array([[[1.0, 25.0], [9.0, 0.0]], [[4.0, 100.0], [4.0, 0.0]], [[9.0, 225.0], [1.0, 0.0]]])
    expected = [100.0, 100 * np.sqrt(0.5)]
    np.testing.assert_allclose(median_course(squared, SCALE), expected)


@pytest.mark.parametrize(("drift", "expected"), [(0.02, (5, True)), (0.001, (8, False))])
def test_the_horizon_of_a_candidate_is_in_seconds_and_at_most_as_long_as_its_rollouts(
    drift: float, expected: tuple[int, bool]
) -> None:
    features = untrained_model(drive()).features
    states = np.zeros((3, 9, 2))
    truth = TrueRollouts(states, np.zeros((3, 8), np.int64), states[:, :1], np.zeros((3, 0), np.int64), {})
    off = drift * np.arange(1, 9)[None, :, None] * np.array(features.scale) * 1.0001
    predicted = np.broadcast_to(off, (3, 8, 2)).astype(np.float32)
    found = Horizon.model_validate(measure_horizon(predicted, truth, features))
    assert (found.seconds, found.lost) == (pytest.approx(expected[0] * features.spaces.step_seconds), expected[1])
