"""Transitions from files and folders of either kind."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import CAR, RUN, assert_same, car_transitions, write_log

from addressed_dynamics.base.errors import AddressedDynamicsError, LogError, TableError
from addressed_dynamics.episodes.parquet import TransitionTable, write_table
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.sources.transitions.reading import read_transitions

FIRST = car_transitions((4, 3))
SECOND = replace(car_transitions((2, 5), seed=1), episode=np.repeat([2, 3], [2, 5]))
WHOLE = Transitions.concatenate([FIRST, SECOND])


def write_parquet(path: Path, part: Transitions) -> None:
    write_table(path, TransitionTable(part, np.zeros(len(part), dtype=np.int8), "some"), row_group_rows=8)


def test_a_log_and_a_folder_of_logs_are_read(tmp_path: Path) -> None:
    write_log(tmp_path / "b.mcap", SECOND)
    write_log(tmp_path / "a.mcap", FIRST)
    assert_same(read_transitions(tmp_path / "a.mcap"), FIRST)
    assert_same(read_transitions(str(tmp_path)), WHOLE)


def test_episodes_of_different_recordings_are_different_whatever_their_numbers(tmp_path: Path) -> None:
    # The second recording is in two logs, and shares the number 2 with the first alone.
    parts = [car_transitions((2, 1, 3), seed=0), *(car_transitions((lengths), seed=1) for lengths in [(2,), (4, 1)])]
    parts[1] = replace(parts[1], episode=parts[1].episode + 2)
    parts[2] = replace(parts[2], episode=parts[2].episode + 3)
    other = replace(RUN, started="2020-01-01T00:00:00.000001+00:00")
    for name, part, run in zip(("a", "b-000", "b-001"), parts, (RUN, other, other), strict=True):
        write_log(tmp_path / f"{name}.mcap", part, run=run)
    whole = read_transitions(tmp_path)
    numbers = np.repeat(np.arange(6), [2, 1, 3, 2, 4, 1])
    np.testing.assert_array_equal(whole.episode, numbers)
    np.testing.assert_array_equal(whole.observation, np.concatenate([part.observation for part in parts]))


def test_numbers_that_do_not_clash_stay_as_they_are(tmp_path: Path) -> None:
    write_log(tmp_path / "b.mcap", FIRST, run=replace(RUN, segment="other"))
    write_log(tmp_path / "a.mcap", SECOND)
    np.testing.assert_array_equal(read_transitions(tmp_path).episode, np.repeat([2, 3, 0, 1], [2, 5, 4, 3]))


def test_an_episode_that_is_twice_in_one_recording_and_a_copy_of_a_log_are_refused(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", FIRST)
    shutil.copy(tmp_path / "a.mcap", tmp_path / "b.mcap")
    with pytest.raises(LogError, match=r"b\.mcap: it is a copy of a\.mcap; remove one of the two"):
        read_transitions(tmp_path)
    write_log(tmp_path / "b.mcap", replace(SECOND, episode=SECOND.episode - 1))
    with pytest.raises(LogError, match=r"b\.mcap: episode 1 is also in a\.mcap, .* first_episode of its own"):
        read_transitions(tmp_path)


def test_a_table_a_folder_of_tables_and_an_experiments_folder_are_read(tmp_path: Path) -> None:
    write_parquet(tmp_path / "transitions" / "b.parquet", SECOND)
    write_parquet(tmp_path / "transitions" / "a.parquet", FIRST)
    assert_same(read_transitions(tmp_path / "transitions" / "a.parquet"), FIRST)
    assert_same(read_transitions(tmp_path / "transitions"), WHOLE)
    assert_same(read_transitions(tmp_path), WHOLE)


def test_what_is_neither_is_refused(tmp_path: Path) -> None:
    with pytest.raises(AddressedDynamicsError, match="nothing is there"):
        read_transitions(tmp_path / "missing.mcap")
    (tmp_path / "notes.txt").write_text("hello")
    with pytest.raises(AddressedDynamicsError, match=r"notes\.txt: expected a file that ends in \.mcap or \.parquet"):
        read_transitions(tmp_path / "notes.txt")
    with pytest.raises(TableError, match="there are none"):
        read_transitions(tmp_path)


def test_logs_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    write_log(tmp_path / "a.mcap", FIRST)
    write_log(tmp_path / "b.mcap", replace(SECOND, spec=replace(CAR, step_seconds=1.0)))
    with pytest.raises(LogError, match="different spaces"):
        read_transitions(tmp_path)
