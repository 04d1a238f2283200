"""The variance of noise by nearest neighbours, on data whose noise is known."""

import numpy as np
import pytest

from addressed_dynamics.episodes.noise import find_noise


def noisy(rows: int, deviation: tuple[float, float], seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    x = generator.uniform(-1.0, 1.0, (rows, 2))
    true = np.column_stack([np.sin(2 * x[:, 0]), x[:, 0] * x[:, 1]])
    return x, true + np.array(deviation) * generator.standard_normal((rows, 2))


@pytest.mark.parametrize("deviation", [(0.0, 0.0), (0.1, 0.4), (0.3, 0.02)])
def test_the_noise_of_each_outcome_is_found_beside_its_own_rows_and_beside_others(
    deviation: tuple[float, float],
) -> None:
    rows = noisy(3_000, deviation)
    for found in (find_noise(*rows), find_noise(*noisy(1_000, deviation, seed=1), rows)):
        assert found is not None
        np.testing.assert_allclose(np.sqrt(found.variance), deviation, rtol=0.1, atol=0.012)
        np.testing.assert_allclose(found.absolute, np.sqrt(2 / np.pi) * np.array(deviation), rtol=0.1, atol=0.012)


def test_the_mean_absolute_value_of_noise_with_long_tails_is_smaller_than_that_of_normal_noise() -> None:
    generator = np.random.default_rng(2)
    x, noise = generator.uniform(-1.0, 1.0, (6_000, 1)), generator.laplace(size=(6_000, 1))
    found = find_noise(x, x + noise)
    assert found is not None
    np.testing.assert_allclose(np.sqrt(found.variance), [np.sqrt(2)], rtol=0.07)
    # The difference of two such values is by 1.06 nearer to normal than each of them, whose mean absolute value is 1.
    np.testing.assert_allclose(found.absolute, [1.06], rtol=0.05)


def test_copies_of_a_row_are_neighbours_of_it_but_the_row_is_not() -> None:
    inputs = np.repeat(np.arange(4.0)[:, None], 5, axis=0)
    outcomes = np.tile([0.0, 1.0, 0.0, 1.0, 0.0], 4)[:, None]
    found = find_noise(inputs, outcomes, neighbours=4)
    # Of the 20 ordered pairs among five copies, 12 differ by 1: half of their mean square is 0.3.
    assert found is not None
    np.testing.assert_allclose(found.variance, [0.3])


@pytest.mark.parametrize("rows", [0, 1, 2])
def test_without_two_neighbours_nothing_is_known(rows: int) -> None:
    assert find_noise(np.zeros((rows, 1)), np.zeros((rows, 1))) is None


def test_there_are_no_more_neighbours_than_rows() -> None:
    x = np.arange(3.0)[:, None]
    found = find_noise(x, np.ones((3, 1)))
    assert found is not None
    assert (found.variance.tolist(), found.absolute.tolist()) == ([0.0], [0.0])
