"""Errors after a step, 1 s and 10 s, and how they stand in the table of errors against the horizon."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from learning import drive

from addressed_dynamics.evaluation.transitions.errors_after import errors_after, moments
from addressed_dynamics.evaluation.transitions.records import ErrorAfter
from addressed_dynamics.evaluation.transitions.rollouts import evaluate_rollouts
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, replay_recorded
from addressed_dynamics.sources.transitions.params import RecordedRollouts

SCALE = np.array([2.0, 10.0])


@pytest.mark.parametrize(
    ("step_seconds", "longest", "expected"),
    [
        (0.02, 1000, (1, 50, 500)),
        (1 / 30, 1000, (1, 30, 300)),
        (0.05, 100, (1, 20)),
        (0.03, 333, (1, 33, 333)),
        (0.03, 332, (1, 33)),
        (1.0, 10, (1, 10)),
        (3.0, 100, (1, 3)),
        (60.0, 100, (1,)),
        (0.0, 99, (1, 10)),
        (0.0, 100, (1, 10, 100)),
    ],
)
def test_errors_are_told_after_the_steps_that_end_nearest_to_1_and_10_seconds(
    step_seconds: float, longest: int, expected: tuple[int, ...]
) -> None:
    assert moments(step_seconds, longest) == expected


@given(st.floats(1e-4, 100.0), st.integers(1, 10_000))
def test_no_moment_is_told_twice_or_beyond_the_rollouts(step_seconds: float, longest: int) -> None:
    found = moments(step_seconds, longest)
    assert found[0] == 1
    assert list(found) == sorted(set(found))
    assert found[-1] <= longest


def test_errors_are_root_mean_squares_over_rollouts_in_units_and_over_dimensions_in_per_cent() -> None:
    squared = np.zeros((3, 4, 2))
    squared[:, 2] = [[0.01, 0.25], [0.04, 1.0], [0.16, 4.0]]
    first, third = errors_after((1, 3), squared, SCALE, ("position", "speed"))
    read = ErrorAfter.model_validate(third)
    assert (read.steps, read.rollouts, read.interval) == (3, 3, None)
    # Shares of the range: 0.05, 0.1 and 0.2, the same in both dimensions.
    assert read.median_percent == pytest.approx(10.0)
    assert read.percent == pytest.approx(100 * np.sqrt((0.05**2 + 0.1**2 + 0.2**2) / 3))
    assert read.dimensions == pytest.approx({"position": np.sqrt(0.07), "speed": np.sqrt(1.75)})
    assert (first["percent"], first["dimensions"]) == (0.0, {"position": 0.0, "speed": 0.0})


def test_the_interval_is_that_of_the_median_rollout_and_none_where_it_is_not_known() -> None:
    half = np.full((3, 2, 2), np.inf)
    half[:, 0] = [[0.1, 3.0], [0.2, 1.0], [0.9, np.inf]]
    names = ("position", "speed")
    first, second = errors_after((1, 2), np.ones((3, 2, 2)), SCALE, names, half)
    assert first["interval"] == {"position": 0.2, "speed": 3.0}
    assert second["interval"] is None


def rows_of(half: np.ndarray | None) -> tuple[list[dict[str, float]], TrueRollouts, np.ndarray]:
    params = RecordedRollouts(kind="recorded", episodes=30, steps=8)
    world = drive((80, 80, 80))
    truth = replay_recorded(params, world, 1, dict.fromkeys(world.episode.tolist(), "alone"))
    off = np.random.default_rng(0).random((30, 8, 2)) * SCALE
    predicted = (truth.states[:, 1:] + off).astype(np.float32)
    _, rows = evaluate_rollouts("own", predicted, truth, world.spec, SCALE, physics=False, half=half)
    return rows, truth, predicted


def test_the_table_against_the_horizon_has_all_dimensions_as_one() -> None:
    rows, truth, predicted = rows_of(None)
    assert [row["horizon"] for row in rows] == list(range(1, 9))
    for row in rows:
        shares = (predicted[:, row["horizon"] - 1].astype(float) - truth.states[:, row["horizon"]]) / SCALE
        each = 100 * np.sqrt((shares**2).sum(axis=1) / 2)
        found = [row["error_%_p10"], row["error_%_p50"], row["error_%_p90"]]
        assert found == pytest.approx(np.quantile(each, [0.1, 0.5, 0.9]), rel=1e-4)
        assert "interval_%" not in row


def test_the_table_has_the_intervals_of_the_median_rollout_where_they_are_known() -> None:
    half = np.full((30, 8, 2), np.inf)
    half[:, :5] = np.linspace(0.1, 3.0, 30)[:, None, None] * SCALE
    rows, _, _ = rows_of(half)
    assert [row.get("interval_%") for row in rows] == [pytest.approx(155.0)] * 5 + [None] * 3
    assert [row.get("interval.velocity") for row in rows] == [pytest.approx(15.5)] * 5 + [None] * 3
    assert all(np.isfinite(list(row.values())[3:]).all() for row in rows)
