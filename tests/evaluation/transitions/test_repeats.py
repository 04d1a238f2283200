"""How many test transitions stand in training, exactly or but for rounding."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import drive, untrained_model

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import Repeats
from addressed_dynamics.evaluation.transitions.repeats import repeated, repeats

TRAIN = drive((30, 30))
FEATURES = untrained_model(TRAIN).features


def found(test: Transitions, off: np.ndarray | float = 0.0) -> Repeats:
    points = Points.of(test, FEATURES)
    predicted = torch.from_numpy(points.next_observation.astype(np.float64) + off)
    return Repeats.model_validate(repeats(Points.of(TRAIN, FEATURES), points, predicted))


def test_rows_of_training_are_found_and_errors_are_without_them() -> None:
    test = drive((20, 20), seed=1)
    observation = test.observation.copy()
    action = test.action.copy()
    observation[:5], action[:5] = TRAIN.observation[7:12], TRAIN.action[7:12]
    # The same states with another action are no repeats.
    observation[5:8], action[5:8] = TRAIN.observation[20:23], 2 - TRAIN.action[20:23]
    action[5:8] = np.where(action[5:8] == TRAIN.action[20:23], 0, action[5:8])
    observation[10], action[10] = np.nextafter(TRAIN.observation[3], np.float32(9)), TRAIN.action[3]
    off = np.zeros_like(observation, dtype=np.float64)
    off[[0, 1, 2, 3, 4, 10]] = 0.3 * np.array(FEATURES.scale)
    off[15] = 0.1 * np.array(FEATURES.scale)
    after = np.where((np.arange(40) % 20 == 19)[:, None], test.next_observation, np.roll(observation, -1, axis=0))
    read = found(replace(test, observation=observation, action=action, next_observation=after), off)
    assert (read.rows, read.among, read.exact, read.alike) == (40, 60, 5, 6)
    assert read.percent == pytest.approx(100 * np.sqrt((6 * 0.09 + 0.01) / 40), rel=1e-4)
    assert read.percent_without == pytest.approx(100 * np.sqrt(0.01 / 34), rel=1e-4)


def test_where_all_test_transitions_stand_in_training_there_is_no_error_without_them() -> None:
    read = found(TRAIN, off=0.0)
    assert (read.exact, read.alike) == (60, 60)
    assert read.percent_without is None


@given(st.integers(1, 40), st.integers(1, 4), st.integers(0, 2**31 - 1))
def test_what_is_repeated_is_what_a_loop_over_all_pairs_finds(rows: int, columns: int, seed: int) -> None:
    generator = np.random.default_rng(seed)
    among = generator.normal(size=(25, columns)).astype(np.float32).round(1)
    asked = among[generator.integers(0, 25, rows)]
    asked += generator.integers(-2, 3, asked.shape).astype(np.float32) * np.float32(2.0**-24)
    exact, alike = repeated(asked.astype(np.float64), among.astype(np.float64))
    unit = np.spacing(np.maximum(np.abs(asked).max(axis=0), np.abs(among).max(axis=0))).astype(np.float64)
    for row, is_exact, is_alike in zip(asked.astype(np.float64), exact, alike, strict=True):
        apart = np.abs(among.astype(np.float64) - row)
        assert is_exact == (apart == 0).all(axis=1).any()
        assert is_alike == (apart <= unit).all(axis=1).any()


def test_many_equal_and_many_near_rows_are_told_apart_in_time() -> None:
    at_rest = np.tile(np.array([[0.6, 0.07, 2.0]], np.float32), (5000, 1))
    settling = at_rest + np.linspace(0.0, 1e-3, 5000, dtype=np.float32)[:, None] * np.float32([1, 1, 0])
    exact, alike = repeated(at_rest[:200].astype(np.float64), np.concatenate([settling, at_rest]).astype(np.float64))
    assert exact.all()
    assert alike.all()
    far = at_rest[:200].astype(np.float64) - np.array([0.0, 0.0, 1.0])
    assert not np.any(repeated(far, np.concatenate([settling, at_rest]).astype(np.float64)))
