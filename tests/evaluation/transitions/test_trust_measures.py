"""By what trust is judged: brute force over pairs, hand-made orders and counted cells are the oracles."""

from itertools import permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.transitions.trust_measures import (
    COVERAGES,
    auroc,
    break_even_steps,
    covered,
    map_edges,
    risk_against_coverage,
    trust_map,
    trusted_steps,
)

scored = st.lists(st.tuples(st.sampled_from([-np.inf, 0.0, 0.5, 1.0, 2.0, np.inf]), st.booleans()), max_size=30)


@given(scored)
def test_auroc_is_the_share_of_pairs_in_the_right_order_and_ties_count_half(points: list[tuple[float, bool]]) -> None:
    score, positive = np.array([each[0] for each in points]), np.array([each[1] for each in points], dtype=np.bool_)
    pairs = [(float(a > b) + float(a == b) / 2) for a in score[positive] for b in score[~positive]]
    found = auroc(score, positive)
    if pairs:
        assert found == pytest.approx(np.mean(pairs), abs=1e-12)
    else:
        assert found is None


def test_auroc_of_known_orders() -> None:
    positive = np.array([False, False, True, True])
    assert auroc(np.array([0.1, 0.2, 0.3, 0.4]), positive) == 1.0
    assert auroc(np.array([0.4, 0.3, 0.2, 0.1]), positive) == 0.0
    assert auroc(np.full(4, 7.0), positive) == 0.5
    assert auroc(np.array([0.1, 0.4, 0.35, 0.8]), positive) == 0.75
    with pytest.raises(EvaluationError, match=r"^[^\n]*1 of 4 values of the score are NaN[^\n]*$"):
        auroc(np.array([0.1, np.nan, 0.3, 0.4]), positive)


def test_risk_grows_from_the_most_trusted_to_the_mean_of_all() -> None:
    error = np.arange(100.0)
    rows = risk_against_coverage(error, trust=-error)
    assert tuple(row.coverage for row in rows) == COVERAGES
    # The n smallest of 0, 1, 2, … have the mean (n - 1) / 2, and n goes up by five.
    assert [row.risk for row in rows] == pytest.approx([(5 * n - 1) / 2 for n in range(1, 21)])
    assert [row.oracle for row in rows] == [row.risk for row in rows]


def test_the_wrong_trust_has_the_highest_risk_first_and_none_has_the_same_everywhere() -> None:
    error = np.random.default_rng(0).exponential(size=57)
    wrong, none = risk_against_coverage(error, trust=error), risk_against_coverage(error, trust=np.ones(57))
    assert wrong[0].risk == pytest.approx(np.sort(error)[-3:].mean())  # 5 % of 57 points are 3 whole ones
    assert [row.risk for row in none] == pytest.approx([error.mean()] * 20)
    assert [wrong[-1].risk, wrong[-1].oracle] == pytest.approx([error.mean()] * 2)


@given(st.lists(st.tuples(st.floats(0, 10), st.integers(0, 2)), min_size=1, max_size=6))
def test_risk_is_the_mean_over_all_orders_of_equals(points: list[tuple[float, int]]) -> None:
    rows = risk_against_coverage(np.array([each[0] for each in points]), np.array([float(each[1]) for each in points]))
    orders = [order for order in permutations(points) if list(order) == sorted(order, key=lambda each: -each[1])]
    for row, twentieths in zip(rows, range(1, 21), strict=True):
        kept = -(-len(points) * twentieths // 20)
        assert row.risk == pytest.approx(np.mean([[error for error, _ in order[:kept]] for order in orders]), abs=1e-9)
        assert row.oracle == pytest.approx(np.mean(sorted(error for error, _ in points)[:kept]), abs=1e-9)


def test_risk_of_no_points_and_of_nan() -> None:
    assert risk_against_coverage(np.empty(0), np.empty(0)) == ()
    with pytest.raises(EvaluationError, match="2 of 3 values of the trust are NaN"):
        risk_against_coverage(np.ones(3), np.array([np.nan, 1.0, np.nan]))


def test_what_lies_in_its_interval_is_counted_by_dimension_of_all_and_together() -> None:
    truth = np.array([[0.0, 0.0], [1.0, 5.0], [2.0, 9.0], [3.0, 0.0]])
    low, high = np.array([[0.0, -1.0]] * 4), np.array([[2.0, 1.0]] * 4)
    found = covered(truth, low, high)
    assert found.dimensions.tolist() == [0.75, 0.5]
    assert (found.of_all, found.together) == (0.625, 0.25)
    twice = covered(*(np.stack([each, each]) for each in (truth, low, high)))
    assert twice.dimensions.tolist() == [0.75, 0.5]


def test_an_interval_of_nan_covers_nothing_and_an_infinite_one_everything() -> None:
    truth = np.array([[1.0, 1.0, np.nan]])
    found = covered(truth, np.array([[np.nan, -np.inf, -np.inf]]), np.array([[2.0, np.inf, np.inf]]))
    assert found.dimensions.tolist() == [0.0, 1.0, 0.0]
    with pytest.raises(EvaluationError, match="at least one point"):
        covered(np.empty((0, 2)), np.empty((0, 2)), np.empty((0, 2)))


@given(st.floats(0.05, 0.95), st.integers(1, 4))
def test_intervals_of_known_quantiles_cover_their_share(share: float, width: int) -> None:
    truth = np.random.default_rng(1).uniform(size=(4000, width))
    found = covered(truth, np.zeros_like(truth), np.full_like(truth, share))
    assert found.of_all == pytest.approx(share, abs=0.04)
    assert found.together == pytest.approx(share**width, abs=0.04)


@pytest.mark.parametrize(
    ("model", "expected"),
    [
        ([0.1, 0.2, 0.3], None),
        ([1.0, 2.0, 3.0], None),  # as bad is not worse
        ([0.1, 2.5, 0.3], 2),
        ([1.1, 0.0, 0.0], 1),
        ([0.1, 0.2, np.nan], 3),
        ([0.1, np.inf, np.inf], 2),
    ],
)
def test_a_model_breaks_even_until_it_is_first_worse(model: list[float], expected: int | None) -> None:
    assert break_even_steps(np.array(model), np.array([1.0, 2.0, 3.0])) == expected


def test_trust_ends_where_the_median_width_of_the_worst_dimension_exceeds_its_share() -> None:
    steps = np.arange(1, 11, dtype=np.float64)
    episodes = np.stack([steps * factor for factor in (0.5, 1.0, 100.0)])  # the median is the second
    width = np.stack([episodes * 0.001, episodes], axis=2)
    scale = np.array([1.0, 50.0])
    assert trusted_steps(width, scale, 0.1) == 5  # a width of 5 is a tenth of 50, one of 6 is more
    assert trusted_steps(width, scale, 0.01) == 0
    assert trusted_steps(width, scale, 0.2) == 10
    assert trusted_steps(width, np.array([0.03, 50.0]), 0.1) == 3
    width[:2, 2, 0] = np.nan
    assert trusted_steps(width, scale, 0.1) == 2
    with pytest.raises(EvaluationError, match="ranges above 0"):
        trusted_steps(width, np.array([0.0, 1.0]), 0.1)


def test_a_map_holds_the_mean_trust_of_each_cell_and_nan_where_nothing_is() -> None:
    states = np.array([[0.0, 0.0], [0.4, 0.1], [2.0, 4.0], [2.0, 0.0]])
    found = trust_map(states, np.array([0.2, 0.4, 1.0, 0.5]), 2)
    np.testing.assert_allclose(found, [[0.3, 0.5], [np.nan, 1.0]])
    assert map_edges(states, 2).tolist() == [[0.0, 1.0, 2.0], [0.0, 2.0, 4.0]]


@given(st.integers(1, 60), st.integers(1, 7), st.integers(0, 2**16))
def test_every_point_is_in_one_cell_of_the_map(points: int, cells: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    states, trust = generator.normal(size=(points, 2)).astype(np.float32), generator.random(points)
    found, edges = trust_map(states, trust, cells), map_edges(states, cells)
    for row in range(cells):
        for column in range(cells):
            left, low = edges[0, column], edges[1, row]
            # A cell holds its lower edges; the last ones hold their upper edges too.
            inside = (states[:, 0] >= left) & (states[:, 1] >= low)
            if column < cells - 1:
                inside &= states[:, 0] < edges[0, column + 1]
            if row < cells - 1:
                inside &= states[:, 1] < edges[1, row + 1]
            expected = trust[inside].mean() if inside.any() else np.nan
            np.testing.assert_allclose(found[row, column], expected, rtol=1e-12)


def test_a_map_of_one_place_or_of_none() -> None:
    found = trust_map(np.ones((3, 2)), np.array([0.0, 0.5, 1.0]), 3)
    assert np.nanmax(found) == 0.5
    assert np.isnan(found).sum() == 8
    with pytest.raises(EvaluationError, match="at least one point"):
        trust_map(np.empty((0, 2)), np.empty(0), 3)


def test_coverage_of_episodes_is_the_mean_of_theirs_with_its_standard_error() -> None:
    truth = np.array([[0.5], [2.0], [2.0], [2.0], [0.5]])
    low, high, episode = np.zeros((5, 1)), np.ones((5, 1)), np.array([0, 0, 0, 0, 1])
    found = covered(truth, low, high, episode)
    assert (found.of_all, found.together, found.dimensions.tolist()) == (0.625, 0.625, [0.625])
    assert found.error == pytest.approx(0.375)
    assert covered(truth, low, high).of_all == pytest.approx(0.4)
    assert covered(truth, low, high).error is None
    assert covered(truth, low, high, np.zeros(5, np.int64)).error is None
