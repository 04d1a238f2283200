"""Starts of a learned environment: windows of recorded training episodes, kept with the models."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from learning import drive, sail, swing

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.evaluation.transitions.starting import MOST, starts_of
from addressed_dynamics.simulators.starts import (
    ARRAYS,
    COLUMNS,
    FOLDER,
    Starts,
    read_starts,
    write_starts,
)

WORLDS = {"car": drive, "arm": swing, "boat": sail}


def check_windows(starts: Starts, train: Transitions, history: int) -> None:
    """Every start is what its episode had in its steps."""
    place = {(int(e), int(s)): row for row, (e, s) in enumerate(zip(train.episode, train.step, strict=True))}
    for index in range(len(starts)):
        last = place[int(starts.episode[index]), int(starts.step[index])]
        rows = np.arange(last - history + 1, last + 1)
        assert (train.episode[rows] == starts.episode[index]).all()
        np.testing.assert_array_equal(starts.observation[index], train.observation[rows])
        np.testing.assert_array_equal(starts.action[index], train.action[rows[:-1]])
        if train.spec.exogenous:
            rest = np.flatnonzero((train.episode == starts.episode[index]) & (np.arange(len(train)) >= rows[0]))
            replayed = starts.exogenous[starts.row[index] : starts.stop[index]]
            np.testing.assert_array_equal(replayed, train.exogenous[rest])


@given(st.sampled_from([*WORLDS]), st.lists(st.integers(1, 12), min_size=1, max_size=6), st.integers(1, 4))
def test_starts_are_windows_of_episodes_as_they_were_recorded(world: str, lengths: list[int], history: int) -> None:
    train = WORLDS[world]([*lengths, 5])
    starts = starts_of(train, history)
    check_windows(starts, train, history)
    found = sorted(zip(starts.episode.tolist(), starts.step.tolist(), strict=True))
    rows = zip(train.episode.tolist(), train.step.tolist(), strict=True)
    assert found == [(episode, step) for episode, step in rows if step >= history - 1]
    np.testing.assert_array_equal(starts.beginning, starts.step == history - 1)


def test_of_many_rows_half_are_where_episodes_begin() -> None:
    starts = starts_of(drive((3,) * 700), 2)
    assert (len(starts), starts.beginning.sum(), (starts.step[starts.beginning] == 1).all()) == (MOST, MOST // 2, True)
    few = starts_of(drive((1000, 1000)), 1)
    assert (len(few), few.beginning.sum(), few.step[few.beginning].tolist()) == (MOST, 2, [0, 0])
    assert len(np.unique(few.episode * 1000 + few.step)) == MOST
    check_windows(few, drive((1000, 1000)), 1)


def test_starts_know_the_range_of_recorded_continuous_actions() -> None:
    train = swing()
    np.testing.assert_array_equal(
        starts_of(train, 1).action_range, [train.action.min(axis=0), train.action.max(axis=0)]
    )
    assert starts_of(drive(), 1).action_range.shape == (2, 0)


@pytest.mark.parametrize("world", WORLDS)
def test_starts_are_read_as_they_were_written_and_their_bytes_repeat(world: str, tmp_path: Path) -> None:
    starts = starts_of(WORLDS[world]((9, 4)), 3)
    written = []
    for _ in range(2):
        write_starts(tmp_path, starts)
        written.append({path.name: path.read_bytes() for path in (tmp_path / FOLDER).iterdir()})
    assert written[0] == written[1]
    found = read_starts(tmp_path)
    assert found.spaces == starts.spaces
    for name in COLUMNS:
        column, expected = getattr(found, name), getattr(starts, name)
        assert column.dtype == expected.dtype
        np.testing.assert_array_equal(column, expected)


def test_missing_starts_name_the_command_that_makes_them(tmp_path: Path) -> None:
    with pytest.raises(
        ModelError, match=r"starts: missing.*'dvc repro evaluate@car' writes them; or give one"
    ) as error:
        read_starts(tmp_path / "car")
    assert "\n" not in str(error.value)
    write_starts(tmp_path, None)
    with pytest.raises(ModelError, match="keeps no recorded state to start from: these models are of another kind"):
        read_starts(tmp_path)


def test_damaged_starts_name_the_command_that_makes_them_anew(tmp_path: Path) -> None:
    write_starts(tmp_path, starts_of(drive(), 1))
    (tmp_path / FOLDER / ARRAYS).write_bytes(b"no archive")
    with pytest.raises(ModelError, match=r"starts: incomplete or damaged .*'dvc repro evaluate@.*' writes them anew"):
        read_starts(tmp_path)


def test_a_history_longer_than_all_but_one_episode_leaves_its_windows() -> None:
    train = drive((2, 6, 2))
    starts = starts_of(train, 5)
    assert starts.episode.tolist() == [1, 1]
    assert starts_of(replace(train), 5).step.tolist() == [4, 5]
