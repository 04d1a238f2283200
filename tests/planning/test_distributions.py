"""Where plans come from, and how that moves."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from addressed_dynamics.planning.bounds import Box
from addressed_dynamics.planning.distributions import Categorical, Gaussian


def test_actions_are_drawn_as_often_as_their_probabilities_say() -> None:
    probabilities = np.array([[0.2, 0.5, 0.3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    drawn = Categorical(probabilities).draw(20_000, np.random.default_rng(0))
    shares = np.stack([(drawn == action).mean(axis=0) for action in range(3)], axis=1)
    np.testing.assert_allclose(shares, probabilities, atol=0.015)
    np.testing.assert_array_equal(shares[1:], probabilities[1:])


@settings(max_examples=50, deadline=None)
@given(arrays(np.int64, (7, 4), elements=st.integers(0, 2)), st.floats(0.01, 1.0))
def test_probabilities_move_to_the_shares_among_the_elites_and_stay_probabilities(elites, smoothing: float) -> None:
    first = Categorical.uniform(4, 3)
    shares = np.stack([(elites == action).mean(axis=0) for action in range(3)], axis=1)
    fitted = first.fitted(elites, smoothing)
    np.testing.assert_allclose(fitted.probabilities, (1 - smoothing) / 3 + smoothing * shares)
    later = fitted.shifted()
    for each in (fitted, later):
        np.testing.assert_allclose(each.probabilities.sum(axis=1), 1.0)
    assert (later.probabilities > 0.0).all()
    np.testing.assert_array_equal(later.likeliest()[:-1], fitted.likeliest()[1:])


def test_a_normal_distribution_moves_to_mean_and_deviation_of_the_elites_and_stays_in_the_box() -> None:
    box = Box(np.array([-1.0, 0.0]), np.array([1.0, 10.0]))
    first = Gaussian.middle(3, box)
    drawn = first.draw(5_000, np.random.default_rng(0))
    np.testing.assert_allclose(drawn.mean(axis=(0, 1)), [0.0, 5.0], atol=0.1)
    assert (drawn >= box.low).all()
    assert (drawn <= box.high).all()
    fitted = first.fitted(drawn[:10], 1.0)
    np.testing.assert_allclose(fitted.mean, drawn[:10].mean(axis=0))
    np.testing.assert_allclose(fitted.deviation, drawn[:10].std(axis=0))
    np.testing.assert_allclose(first.fitted(drawn[:1], 1.0).deviation, [[2e-3, 1e-2]] * 3)
    np.testing.assert_array_equal(fitted.shifted().mean, fitted.mean[[1, 2, 2]])
