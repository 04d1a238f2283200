"""Transitions from files and folders of either kind."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from builders import CAR, assert_same, car_transitions, write_log

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
