"""What tables say about their data: statistics, coverage, duplicates, episodes and the data report."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from builders import CAR, WINDY, car_transitions
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import random_transitions

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.coverage import CELLS, Occupancy
from addressed_dynamics.episodes.fingerprints import find_duplicates, row_fingerprints
from addressed_dynamics.episodes.index import Episode, read_episodes, write_episodes
from addressed_dynamics.episodes.statistics import Moments, column_names, column_values
from addressed_dynamics.episodes.summary import data_report, split_sizes, write_learner_curve

values = arrays(np.float32, st.tuples(st.integers(0, 30), st.just(3)), elements=st.floats(-100, 100, width=32))


@given(values, st.data())
def test_moments_of_parts_merge_into_those_of_the_whole(whole: np.ndarray, data: Any) -> None:
    assume(len(whole))
    cuts = sorted(data.draw(st.lists(st.integers(0, len(whole)), max_size=3)))
    merged = Moments.of(whole[:0])
    for part in np.split(whole, cuts):
        merged = merged.merge(Moments.of(part))
    exact = whole.astype(np.float64)
    assert merged.count == len(whole)
    np.testing.assert_allclose(merged.mean, exact.mean(axis=0), atol=1e-12, rtol=1e-12)
    np.testing.assert_allclose(merged.std, exact.std(axis=0), atol=1e-6, rtol=1e-9)
    np.testing.assert_array_equal(merged.minimum, exact.min(axis=0))
    np.testing.assert_array_equal(merged.maximum, exact.max(axis=0))


def test_a_constant_column_has_no_spread_at_all() -> None:
    moments = Moments.of(np.full((1000, 1), 0.1, dtype=np.float32))
    assert moments.std[0] == pytest.approx(0, abs=1e-15)


def test_statistics_cover_the_observation_its_change_and_the_reward() -> None:
    whole = car_transitions((3, 2))
    names, columns = column_names(whole), column_values(whole)
    assert names == [
        "observation.position",
        "observation.velocity",
        "change.position",
        "change.velocity",
        "reward",
    ]
    change = whole.next_observation.astype(np.float64) - whole.observation
    np.testing.assert_array_equal(columns[:, 2:4], change)


def test_statistics_cover_exogenous_inputs() -> None:
    whole = random_transitions(WINDY, [3, 2], np.random.default_rng(0))
    names, columns = column_names(whole), column_values(whole)
    assert names[-3:] == ["exogenous.wind", "exogenous.slope", "reward"]
    np.testing.assert_array_equal(columns[:, -3:-1], whole.exogenous)


@given(arrays(np.float32, st.tuples(st.integers(1, 40), st.just(2)), elements=st.floats(-1, 1, width=32)))
def test_occupancy_counts_the_cells_that_a_naive_loop_finds(observation: np.ndarray) -> None:
    low, high = np.array([-1.0, -1.0]), np.array([1.0, 1.0])
    cells = {
        tuple(min(int((float(value) + 1) / 2 * CELLS), CELLS - 1) for value in row) for row in observation.tolist()
    }
    occupancy = Occupancy.of(observation[:1], low, high).merge(Occupancy.of(observation, low, high))
    assert occupancy.grid is not None
    assert set(zip(*np.nonzero(occupancy.grid), strict=True)) == cells
    for dimension in range(2):
        assert set(np.flatnonzero(occupancy.per_dimension[dimension])) == {cell[dimension] for cell in cells}


def test_more_than_two_dimensions_have_no_plane_and_a_constant_one_has_one_cell() -> None:
    observation = np.zeros((5, 3), dtype=np.float32)
    occupancy = Occupancy.of(observation, np.zeros(3), np.array([1.0, 1.0, 0.0]))
    assert occupancy.grid is None
    np.testing.assert_array_equal(occupancy.per_dimension.sum(axis=1), 1)


@given(
    arrays(np.float32, st.tuples(st.just(20), st.just(2)), elements=st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5])),
    arrays(np.int64, 20, elements=st.integers(0, 2)),
)
def test_duplicates_are_the_rows_that_a_set_of_tuples_drops(observation: np.ndarray, action: np.ndarray) -> None:
    rows = {(*map(float, state), int(number)) for state, number in zip(observation, action, strict=True)}
    assert find_duplicates(row_fingerprints(observation, action)).count == len(action) - len(rows)


def test_fingerprints_of_a_hundred_thousand_different_rows_differ() -> None:
    column = np.arange(100_000, dtype=np.float32)
    assert find_duplicates(row_fingerprints(column, column[::-1])).count == 0


def episode(number: int, **values: Any) -> Episode:
    defaults = {
        "name": f"learner-env00-000#{number}",
        "segment": "learner",
        "split": "train",
        "seed": None,
        "length": 10,
        "total_reward": -10.0,
        "ended": "truncated",
        "end_time_ns": round((number + 1) * 10 * CAR.step_seconds * 1e9) - 1,
    }
    return Episode(episode=number, **(defaults | values))


EPISODES = [
    *[episode(number) for number in range(100)],
    *[episode(number, ended="terminated", length=5, total_reward=-5.0) for number in range(100, 150)],
    episode(150, ended="cut", length=1, total_reward=-1.0, split="test", seed=7),
]


def report(episodes: list[Episode]) -> dict[str, Any]:
    observation = np.array([[-1.2, -0.07], [0.6, 0.07]], dtype=np.float32)
    low, high = observation
    return data_report(
        CAR,
        episodes,
        {"learner": "dqn"},
        splits=split_sizes(episodes),
        ranges=[(-1.2, 0.6), (-0.07, 0.07)],
        occupancy=Occupancy.of(observation, low, high),
        duplicates=3,
    )


def test_episodes_survive_their_table(tmp_path: Path) -> None:
    path = tmp_path / "episodes.parquet"
    write_episodes(path, EPISODES)
    assert read_episodes(path) == EPISODES
    assert pq.read_table(path).column("return").to_pylist()[-1] == -1.0


def test_a_damaged_or_foreign_table_of_episodes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "episodes.parquet"
    with pytest.raises(TableError, match="no such table"):
        read_episodes(path)
    write_episodes(path, EPISODES)
    table = pq.read_table(path)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(TableError, match="cannot be read"):
        read_episodes(path)
    pq.write_table(table.drop_columns(["seed"]), path)
    with pytest.raises(TableError, match="expected the columns episode, name, segment"):
        read_episodes(path)


def test_the_data_report_says_what_is_in_the_data() -> None:
    found = report(EPISODES)
    learner = found["segments"]["learner"]
    assert found["transitions"] == 100 * 10 + 50 * 5 + 1
    assert found["splits"]["test"] == {"episodes": 1, "transitions": 1}
    assert found["episodes"]["ended"] == {"terminated": 50, "truncated": 100, "cut": 1}
    assert found["episodes"]["return"]["max"] == -5.0
    assert learner["terminated_share_last_100"] == 0.5
    assert learner["mean_return_by_block"][0] == -10.0
    assert learner["mean_return_by_block"][-1] == -5.0
    assert found["coverage"] == {
        "cells_per_dimension": CELLS,
        "per_dimension": {"position": 2 / CELLS, "velocity": 2 / CELLS},
        "plane": 2 / CELLS**2,
    }
    assert found["duplicates"]["rows"] == 3


def test_a_report_on_nothing_but_a_cut_episode_is_json_without_nan() -> None:
    found = report(EPISODES[-1:])
    assert found["segments"]["learner"]["terminated_share_last_100"] is None
    assert found["episodes"]["return"] is None
    json.dumps(found, allow_nan=False)


def test_the_learning_curve_has_a_row_for_each_finished_episode_in_the_order_of_their_ends(tmp_path: Path) -> None:
    path = tmp_path / "learner.csv"
    write_learner_curve(path, EPISODES[::-1], step_seconds=CAR.step_seconds)
    with path.open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 150
    assert [int(row["index"]) for row in rows] == list(range(150))
    assert [int(row["end_step"]) for row in rows[:3]] == [10, 20, 30]
    assert [int(row["terminated"]) for row in rows] == [0] * 100 + [1] * 50
    assert float(rows[-1]["return"]) == -5.0
