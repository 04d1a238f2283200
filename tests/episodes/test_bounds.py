"""Bounds that say something about the data, and those that do not."""

import numpy as np
import pytest

from addressed_dynamics.episodes.bounds import WIDEST_BOUNDS, display_range, meant_bounds
from addressed_dynamics.episodes.transitions import Dimension


def of(low: float, high: float, least: float = -1.0, most: float = 3.0) -> tuple[float, float]:
    found = meant_bounds([Dimension("angle", "rad", low, high)], np.array([least]), np.array([most]))
    return float(found[0][0]), float(found[1][0])


@pytest.mark.parametrize(
    ("low", "high"), [(-2.0, 4.0), (-2.0, np.inf), (-np.inf, 4.0), (0.0, 4e6), (-1e6, 1e6), (-np.inf, np.inf)]
)
def test_bounds_within_a_million_times_the_range_of_the_data_are_kept(low: float, high: float) -> None:
    assert of(low, high) == (low, high)


@pytest.mark.parametrize(
    ("low", "high"), [(-1e7, 1e7), (0.0, 5e6), (-1e7, np.inf), (-np.inf, 1e7), (-3.4e38, 3.4e38), (-1e29, 1e29)]
)
def test_bounds_farther_out_are_none_on_either_side(low: float, high: float) -> None:
    assert of(low, high) == (-np.inf, np.inf)


def test_a_constant_column_is_measured_by_its_distance_from_0_and_by_1_near_it() -> None:
    assert of(0.0, 5e8, 500.0, 500.0) == (0.0, 5e8)
    assert of(0.0, 5.1e8, 500.0, 500.0) == (-np.inf, np.inf)
    assert of(0.0, WIDEST_BOUNDS, 0.5, 0.5) == (0.0, WIDEST_BOUNDS)
    assert of(0.0, 1.1 * WIDEST_BOUNDS, 0.5, 0.5) == (-np.inf, np.inf)


def test_a_display_reaches_to_the_data_where_a_bound_says_nothing() -> None:
    dimensions = [
        Dimension("near", "m", -2.0, 4.0),
        Dimension("half", "m", -2.0, 1e9),
        Dimension("far", "m", 0, np.inf),
    ]
    low, high = display_range(dimensions, np.array([-1.0, -1.0, 1e7]), np.array([3.0, 3.0, 1e7 + 1]))
    assert low.tolist() == [-2.0, -1.0, 1e7]
    assert high.tolist() == [4.0, 3.0, 1e7 + 1]
