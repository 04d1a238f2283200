"""The paired bootstrap over episodes: what its intervals hold, and what they do not hang on."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import bootstrap

from addressed_dynamics.evaluation.common.bootstrap import (
    COVERAGE,
    DRAWS,
    FEWEST_EPISODES,
    Ratio,
    ratio_of_medians,
    ratio_of_sums,
    weighted_medians,
)

EPISODES = np.arange(60)
both = pytest.mark.parametrize("ratio", [ratio_of_sums, ratio_of_medians])


def made_up(generator: np.random.Generator, times: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Errors of two models in 60 episodes: episodes differ by more than the models do."""
    hard = generator.gamma(2.0, 1.0, 60)
    first, second = generator.uniform(0.7, 1.3, (2, 60))
    return times * hard * first, hard * second


def coverage(ratio) -> float:
    """Share of 300 intervals that hold the true ratio."""
    found = [ratio(*made_up(np.random.default_rng(seed)), EPISODES) for seed in range(300)]
    return np.mean([each.low <= 1.5 <= each.high for each in found])


def test_intervals_of_made_up_data_hold_the_true_ratio_of_means_as_often_as_they_say() -> None:
    assert COVERAGE - 0.03 <= coverage(ratio_of_sums) <= COVERAGE + 0.03


def test_intervals_of_medians_hold_it_at_least_as_often() -> None:
    assert coverage(ratio_of_medians) >= COVERAGE - 0.03


def test_what_differs_between_episodes_alone_does_not_widen_the_interval_of_a_pair() -> None:
    generator = np.random.default_rng(0)
    errors, others = made_up(generator)
    paired = ratio_of_sums(errors, others, EPISODES)
    apart = ratio_of_sums(errors, generator.permutation(others), EPISODES)
    assert paired.high - paired.low < 0.5 * (apart.high - apart.low)


@both
@given(st.lists(st.floats(1e-9, 1e9), min_size=FEWEST_EPISODES, max_size=30))
def test_a_model_beside_itself_has_exactly_its_own_error(ratio, errors: list[float]) -> None:
    values = np.array(errors)
    assert ratio(values, values.copy(), np.arange(len(values))) == Ratio(1.0, 1.0, 1.0)


@both
@settings(max_examples=25)
@given(st.integers(0, 1000), st.integers(1, 3))
def test_the_order_of_the_episodes_does_not_matter(ratio, seed: int, parts: int) -> None:
    generator = np.random.default_rng(seed)
    errors, others = made_up(generator)
    episode = EPISODES // parts
    order = generator.permutation(60)
    one, other = ratio(errors, others, episode), ratio(errors[order], others[order], episode[order])
    np.testing.assert_allclose([other.value, other.low, other.high], [one.value, one.low, one.high], rtol=1e-12)


@both
def test_what_is_compared_the_other_way_round_has_the_reciprocal_interval(ratio) -> None:
    errors, others = made_up(np.random.default_rng(3))
    there, back = ratio(errors, others, EPISODES), ratio(others, errors, EPISODES)
    assert back.value == pytest.approx(1 / there.value)
    # A quantile lies between two draws, and the reciprocal of a mean is not the mean of the reciprocals.
    assert (back.low, back.high) == pytest.approx((1 / there.high, 1 / there.low), rel=1e-3)


@pytest.mark.parametrize(("ratio", "statistic"), [(ratio_of_sums, np.sum), (ratio_of_medians, np.median)])
def test_with_one_part_an_episode_it_is_what_scipy_says(ratio, statistic) -> None:
    errors, others = made_up(np.random.default_rng(1))
    oracle = bootstrap(
        (errors, others),
        lambda own, other, axis: statistic(own, axis=axis) / statistic(other, axis=axis),
        paired=True,
        vectorized=True,
        n_resamples=20 * DRAWS,
        batch=DRAWS,
        method="percentile",
        rng=np.random.default_rng(0),
    ).confidence_interval
    found = ratio(errors, others, EPISODES)
    assert found.value == pytest.approx(statistic(errors) / statistic(others), rel=1e-12)
    width = oracle.high - oracle.low
    assert (found.low, found.high) == pytest.approx((oracle.low, oracle.high), abs=0.1 * width)


def test_parts_of_an_episode_are_drawn_together() -> None:
    # Twenty copies of every episode say nothing that one does not.
    errors, others = made_up(np.random.default_rng(2))
    once = ratio_of_medians(errors, others, EPISODES)
    often = ratio_of_medians(np.repeat(errors, 20), np.repeat(others, 20), np.repeat(EPISODES, 20))
    assert (often.value, often.low, often.high) == pytest.approx((once.value, once.low, once.high), rel=0.05)
    alone = ratio_of_medians(np.repeat(errors, 20), np.repeat(others, 20), np.arange(1200))
    assert alone.high - alone.low < 0.5 * (often.high - often.low)


@given(st.lists(st.tuples(st.floats(0, 1e6), st.integers(0, 4)), min_size=1, max_size=12))
def test_a_weighted_median_is_that_of_the_values_repeated(parts: list[tuple[float, int]]) -> None:
    values, weights = (np.array(each) for each in zip(*parts, strict=True))
    if weights.sum():
        (found,) = weighted_medians(values, weights[None])
        assert found == np.median(np.repeat(values, weights))


@both
def test_a_handful_of_episodes_has_no_interval(ratio) -> None:
    few = np.ones(FEWEST_EPISODES - 1)
    assert ratio(few, few, np.arange(len(few))) is None
    assert ratio(np.ones(40), np.ones(40), np.arange(40) % len(few)) is None


@both
def test_beside_a_model_without_error_there_is_no_ratio(ratio) -> None:
    assert ratio(np.ones(60), np.zeros(60), EPISODES) is None
    rarely = np.where(EPISODES == 0, 1.0, 0.0)
    assert ratio(np.ones(60), rarely, EPISODES) is None


def test_draws_that_are_looked_at_a_few_at_a_time_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    errors, others = made_up(np.random.default_rng(3))
    at_once = [ratio(errors, others, EPISODES) for ratio in (ratio_of_sums, ratio_of_medians)]
    monkeypatch.setattr("addressed_dynamics.evaluation.common.bootstrap.COUNTS", 10 * len(EPISODES))
    assert [ratio(errors, others, EPISODES) for ratio in (ratio_of_sums, ratio_of_medians)] == at_once
