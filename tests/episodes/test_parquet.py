"""Parquet tables of transitions: round trips, equal bytes, and clear errors for what is wrong with a file."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from builders import CAR, WINDY, assert_same, car_transitions
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import random_transitions, transitions

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.parquet import TransitionTable, load_transitions, read_table, write_table
from addressed_dynamics.episodes.splits import SPLITS
from addressed_dynamics.episodes.tables import METADATA_KEY
from addressed_dynamics.episodes.transitions import Transitions


def table_of(whole: Transitions, seed: int = 0) -> TransitionTable:
    """Return a table with a random split for each episode."""
    numbers = np.unique(whole.episode, return_inverse=True)[1]
    splits = np.random.default_rng(seed).integers(0, len(SPLITS), len(whole)).astype(np.int8)
    return TransitionTable(whole, splits[numbers], "learner")


def write(path: Path, lengths: tuple[int, ...] = (4, 3), **arguments: Any) -> Path:
    write_table(path, table_of(car_transitions(lengths, **arguments)), row_group_rows=3)
    return path


def rewrite(path: Path, change: Any) -> Path:
    """Apply `change` to the Arrow table in `path`."""
    table = pq.read_table(path)
    pq.write_table(change(table), path)
    return path


@settings(max_examples=50)
@given(whole=transitions(), rows=st.integers(1, 30))
def test_what_is_written_is_read_back_bit_for_bit(
    tmp_path_factory: pytest.TempPathFactory, whole: Transitions, rows: int
) -> None:
    path = tmp_path_factory.mktemp("table") / "t.parquet"
    table = table_of(whole)
    write_table(path, table, row_group_rows=rows)
    found = read_table(path)
    assert_same(found.transitions, whole)
    np.testing.assert_array_equal(found.split, table.split, strict=True)
    assert found.segment == "learner"


def test_the_same_table_gives_the_same_bytes_and_leaves_no_other_file(tmp_path: Path) -> None:
    first, second = write(tmp_path / "a.parquet"), write(tmp_path / "b.parquet")
    assert first.read_bytes() == second.read_bytes()
    assert sorted(tmp_path.iterdir()) == [first, second]


def test_any_tool_finds_the_columns_by_name(tmp_path: Path) -> None:
    frame = pq.read_table(write(tmp_path / "t.parquet"))
    whole = car_transitions((4, 3))
    np.testing.assert_array_equal(frame.column("observation.velocity").to_numpy(), whole.observation[:, 1])
    np.testing.assert_array_equal(frame.column("next_observation.position").to_numpy(), whole.next_observation[:, 0])
    assert set(frame.column("split").to_pylist()) <= set(SPLITS)
    assert frame.column("segment").to_pylist() == ["learner"] * 7


def test_floats_are_split_by_bytes_and_compressed_in_row_groups_of_the_given_size(tmp_path: Path) -> None:
    metadata = pq.ParquetFile(write(tmp_path / "t.parquet")).metadata
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [3, 3, 1]
    columns = [metadata.row_group(0).column(i) for i in range(metadata.num_columns)]
    assert {column.compression for column in columns} == {"ZSTD"}
    floats = [column for column in columns if column.physical_type == "FLOAT"]
    assert len(floats) == 5
    assert all("BYTE_STREAM_SPLIT" in column.encodings for column in floats)


def test_a_table_of_another_version_is_refused(tmp_path: Path) -> None:
    def from_the_future(table: pa.Table) -> pa.Table:
        about = json.loads(table.schema.metadata[METADATA_KEY]) | {"format_version": 99}
        return table.replace_schema_metadata({METADATA_KEY: json.dumps(about)})

    path = rewrite(write(tmp_path / "t.parquet"), from_the_future)
    with pytest.raises(TableError, match=r"t\.parquet: expected table format 1, found 99; run the convert stage"):
        read_table(path)


@pytest.mark.parametrize("metadata", [None, {METADATA_KEY: "not json"}, {METADATA_KEY: '{"format_version": 1}'}])
def test_a_foreign_parquet_file_is_refused(tmp_path: Path, metadata: Any) -> None:
    path = rewrite(write(tmp_path / "t.parquet"), lambda table: table.replace_schema_metadata(metadata))
    with pytest.raises(TableError, match=r"t\.parquet: (a Parquet file, but not|the description|a description)"):
        read_table(path)


@pytest.mark.parametrize("name", ["observation.velocity", "reward", "next_observation.position"])
def test_a_nan_is_refused_and_located(tmp_path: Path, name: str) -> None:
    def with_nan(table: pa.Table) -> pa.Table:
        values = table.column(name).to_numpy().copy()
        values[5] = np.nan
        return table.set_column(table.schema.get_field_index(name), name, pa.array(values))

    path = rewrite(write(tmp_path / "t.parquet"), with_nan)
    with pytest.raises(TableError, match=rf"t\.parquet: column '{name.split('.')[0]}' .* not finite in row 5"):
        read_table(path)


def test_a_missing_value_is_refused(tmp_path: Path) -> None:
    def with_null(table: pa.Table) -> pa.Table:
        values = pa.array([None, *table.column("action").to_pylist()[1:]], pa.int64())
        return table.set_column(table.schema.get_field_index("action"), "action", values)

    with pytest.raises(TableError, match="column 'action' lacks 1 values"):
        read_table(rewrite(write(tmp_path / "t.parquet"), with_null))


@pytest.mark.parametrize("name", ["episode", "observation.position", "action", "split", "segment"])
def test_a_missing_column_and_one_of_another_type_are_refused(tmp_path: Path, name: str) -> None:
    path = rewrite(write(tmp_path / "t.parquet"), lambda table: table.drop_columns([name]))
    with pytest.raises(TableError, match=f"column '{name}' should be .*, but is missing"):
        read_table(path)

    def with_another_type(table: pa.Table) -> pa.Table:
        return table.set_column(table.schema.get_field_index(name), name, pa.array([b"x"] * len(table)))

    path = rewrite(write(tmp_path / "u.parquet"), with_another_type)
    with pytest.raises(TableError, match=f"column '{name}' should be .*, but is binary"):
        read_table(path)


def test_a_broken_episode_an_unknown_split_and_two_segments_are_refused(tmp_path: Path) -> None:
    path = rewrite(write(tmp_path / "t.parquet"), lambda table: table.take([0, 2, 1, 3, 4, 5, 6]))
    with pytest.raises(TableError, match="is not followed by the next step of its episode; run the convert stage"):
        read_table(path)

    def relabel(name: str, label: str) -> Any:
        def change(table: pa.Table) -> pa.Table:
            labels = [label, *table.column(name).to_pylist()[1:]]
            return table.set_column(table.schema.get_field_index(name), name, pa.array(labels).dictionary_encode())

        return change

    path = rewrite(write(tmp_path / "u.parquet"), relabel("split", "exam"))
    with pytest.raises(TableError, match="expected the splits train, validation, test, found 'exam'"):
        read_table(path)
    path = rewrite(write(tmp_path / "v.parquet"), relabel("segment", "other"))
    with pytest.raises(TableError, match="expected rows of one segment, found 2 segments"):
        read_table(path)


@given(st.data())
def test_a_truncated_file_is_refused_in_one_line(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = write(tmp_path_factory.mktemp("table") / "t.parquet")
    content = path.read_bytes()
    path.write_bytes(content[: data.draw(st.integers(0, len(content) - 1))])
    with pytest.raises(TableError, match=r"t\.parquet: expected a whole Parquet file, but it cannot be read") as caught:
        read_table(path)
    assert "\n" not in str(caught.value)


@settings(max_examples=40)
@given(st.data())
def test_a_flipped_bit_in_the_data_is_never_read_as_data(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = write(tmp_path_factory.mktemp("table") / "t.parquet", (40, 30))
    content = bytearray(path.read_bytes())
    footer = len(content) - 8 - int.from_bytes(content[-8:-4], "little")
    content[data.draw(st.integers(4, footer - 1))] ^= 1 << data.draw(st.integers(0, 7))
    path.write_bytes(content)
    try:
        found = read_table(path).transitions
    except TableError:
        return
    assert_same(found, car_transitions((40, 30)))


def test_a_missing_table_and_an_empty_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(TableError, match=r"t\.parquet: no such table; run the convert stage first"):
        read_table(tmp_path / "t.parquet")
    with pytest.raises(TableError, match="but there are none; run the convert stage first"):
        load_transitions(tmp_path)


def folder_with_two_tables(tmp_path: Path) -> tuple[Path, Transitions]:
    first = car_transitions((4, 3))
    second = car_transitions((5, 2, 2), seed=1)
    second = replace(second, episode=second.episode + 2)
    for name, part in (("a", first), ("b", second)):
        split = (part.episode % 2).astype(np.int8)
        write_table(tmp_path / "transitions" / f"{name}.parquet", TransitionTable(part, split, name), row_group_rows=8)
    return tmp_path, Transitions.concatenate([first, second])


def test_a_folder_is_read_in_the_order_of_its_files_and_by_split(tmp_path: Path) -> None:
    folder, whole = folder_with_two_tables(tmp_path)
    (folder / "episodes.parquet").write_bytes(b"this is not a table of transitions")
    assert_same(load_transitions(folder), whole)
    assert_same(load_transitions(folder / "transitions"), whole)
    assert_same(load_transitions(folder, "train"), whole.select(whole.episode % 2 == 0))
    assert_same(load_transitions(folder, "validation"), whole.select(whole.episode % 2 == 1))


def test_an_empty_split_and_tables_of_different_spaces_are_refused(tmp_path: Path) -> None:
    folder, _ = folder_with_two_tables(tmp_path)
    with pytest.raises(TableError, match=r"no episode is in the split 'test'; .* raise convert\.test_share"):
        load_transitions(folder, "test")
    other = replace(car_transitions((3,)), spec=replace(CAR, step_seconds=1.0))
    write_table(folder / "transitions" / "c.parquet", table_of(other), row_group_rows=8)
    with pytest.raises(TableError, match="different spaces"):
        load_transitions(folder)


def test_exogenous_inputs_are_columns_of_their_own(tmp_path: Path) -> None:
    path, whole = tmp_path / "t.parquet", random_transitions(WINDY, [4, 3], np.random.default_rng(0))
    write_table(path, table_of(whole), row_group_rows=3)
    frame = pq.read_table(path)
    names = frame.column_names
    assert names[names.index("action") : names.index("reward") + 1] == [
        "action", "exogenous.wind", "exogenous.slope", "reward",
    ]  # fmt: skip
    np.testing.assert_array_equal(frame.column("exogenous.slope").to_numpy(), whole.exogenous[:, 1])
    missing = rewrite(path, lambda table: table.drop_columns(["exogenous.wind"]))
    with pytest.raises(TableError, match=r"column 'exogenous.wind' should be float, but is missing"):
        read_table(missing)
