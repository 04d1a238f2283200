"""Parquet tables of motion: round trips, equal bytes, columns by name, and clear errors for what is wrong."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from motion_examples import assert_same_motion, concatenate, make_clip

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.episodes.tables import METADATA_KEY
from addressed_dynamics.sources.motion.splits import MOTION_SPLITS
from addressed_dynamics.sources.motion.tables import load_motion, motion_writer, read_columns, stream_tables

PARTS = [make_clip("run", (6, 5)), make_clip("walk", (8, 4, 7), seed=1), make_clip("jump", (3,), seed=2)]
SPLITS = [np.random.default_rng(n).integers(0, 4, len(part)).astype(np.int8) for n, part in enumerate(PARTS)]


TRAIN_ALONE = [np.zeros(len(part), dtype=np.int8) for part in PARTS]


def write(folder: Path, splits: Sequence[np.ndarray] = SPLITS, **sizes: int) -> Path:
    with motion_writer(folder, **{"row_group_rows": 10} | sizes) as add:
        for part, split in zip(PARTS, splits, strict=True):
            add(part, split)
    return folder


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the only file of a folder of tables, all for training; not to be changed."""
    return write(tmp_path_factory.mktemp("tables") / "motion", TRAIN_ALONE) / "train" / "part-0000.parquet"


@pytest.mark.parametrize("file_rows", [1, 20, 1000])
def test_what_is_written_is_read_back_bit_for_bit_from_one_file_or_many(tmp_path: Path, file_rows: int) -> None:
    alone = write(tmp_path / "alone" / "motion", TRAIN_ALONE, file_rows=file_rows)
    assert len(list((alone / "train").iterdir())) == {1: 3, 20: 2, 1000: 1}[file_rows]
    whole, splits = concatenate(PARTS), np.concatenate(SPLITS)
    found = load_motion(alone.parent)
    assert_same_motion(found, whole)
    assert (found.x.dtype, found.frame.dtype) == (np.float32, np.int64)
    assert max(map(len, stream_tables(alone))) == 10
    folder = write(tmp_path / "tables" / "motion", file_rows=file_rows)
    parts = [whole.select(splits == code) for code in range(4)]
    for code, part in enumerate(parts):
        assert_same_motion(load_motion(folder, MOTION_SPLITS[code]), part)
    assert_same_motion(load_motion(folder.parent), concatenate(parts))


def test_a_split_is_read_from_its_own_files_alone(tmp_path: Path) -> None:
    folder = write(tmp_path / "motion")
    assert {path.name for path in folder.iterdir()} == set(MOTION_SPLITS[:4])
    for split in MOTION_SPLITS[1:4]:
        (folder / split / "part-0000.parquet").write_bytes(b"nobody who trains reads this")
    assert_same_motion(load_motion(folder, "train"), concatenate(PARTS).select(np.concatenate(SPLITS) == 0))
    with pytest.raises(TableError, match="expected a whole Parquet file"):
        load_motion(folder)


def test_row_groups_are_not_too_small_however_few_rows_of_a_split_come_at_once(tmp_path: Path) -> None:
    clip = make_clip("run", (60,))
    split = (np.arange(60) % 10 == 0).astype(np.int8)
    with motion_writer(tmp_path / "motion", row_group_rows=10) as add:
        for start in range(0, 60, 10):
            add(clip.select(slice(start, start + 10)), split[start : start + 10])
    for name, sizes in (("train", [9] * 6), ("validation", [2, 2, 2])):
        metadata = pq.ParquetFile(tmp_path / "motion" / name / "part-0000.parquet").metadata
        assert [metadata.row_group(index).num_rows for index in range(metadata.num_row_groups)] == sizes


def test_the_same_motion_gives_the_same_bytes_and_leaves_no_other_file(tmp_path: Path, table: Path) -> None:
    again = write(tmp_path / "motion", TRAIN_ALONE) / "train" / "part-0000.parquet"
    assert again.read_bytes() == table.read_bytes()
    assert list(tmp_path.rglob("*")) == [tmp_path / "motion", again.parent, again]


def test_nothing_appears_if_writing_fails(tmp_path: Path) -> None:
    def write_and_fail() -> None:
        with motion_writer(tmp_path / "motion", row_group_rows=10) as add:
            add(PARTS[0], SPLITS[0])
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_and_fail()
    assert not list(tmp_path.iterdir())


def test_any_tool_finds_every_column_by_name_with_its_unit(table: Path) -> None:
    frame, whole = pq.read_table(table), concatenate(PARTS)
    for prefix, layout, values in (("input", INPUT, whole.x), ("output", OUTPUT, whole.y)):
        for index, name in enumerate(layout.names):
            np.testing.assert_array_equal(frame.column(f"{prefix}.{name}").to_numpy(), values[:, index])
    assert frame.column("clip").to_pylist() == whole.clip.tolist()
    about = json.loads(frame.schema.metadata[METADATA_KEY])
    assert (about["kind"], about["format_version"], about["frame_rate"]) == ("motion", 1, 60)
    (block,) = [each for each in about["layout"]["input"] if each["block"] == "joint_velocity"]
    assert (block["columns"][3], block["unit"]) == ("LHipJoint.x", "cm/frame")


def test_some_columns_are_read_without_the_others(table: Path) -> None:
    names = ["output.root_turn", "clip", "input.joint_velocity.Hips.x", "split", "frame"]
    for path in (table, table.parent):
        found = read_columns(path, names)
        assert list(found) == names
        np.testing.assert_array_equal(found["output.root_turn"], concatenate(PARTS).y[:, OUTPUT.root_turn][:, 0])
        assert found["clip"].tolist() == concatenate(PARTS).clip.tolist()
        assert found["split"].tolist() == ["train"] * len(concatenate(PARTS))
    with pytest.raises(
        TableError, match=r"there is no column 'output\.speed' in such a table; for instance, it has 'output\."
    ):
        read_columns(table, ["output.speed"])


def test_floats_are_split_by_bytes_and_compressed_with_checksums(table: Path) -> None:
    metadata = pq.ParquetFile(table).metadata
    assert [metadata.row_group(i).num_rows for i in range(metadata.num_row_groups)] == [10, 1, 10, 9, 3]
    columns = [metadata.row_group(0).column(i) for i in range(metadata.num_columns)]
    assert {column.compression for column in columns} == {"ZSTD"}
    floats = [column for column in columns if column.physical_type == "FLOAT"]
    assert len(floats) == INPUT.width + OUTPUT.width + 1
    assert all("BYTE_STREAM_SPLIT" in column.encodings for column in floats)


def with_metadata(change: Any) -> Any:
    def changed(table: pa.Table) -> pa.Table:
        about = json.loads(table.schema.metadata[METADATA_KEY])
        return table.replace_schema_metadata({METADATA_KEY: json.dumps(change(about))})

    return changed


def with_column(name: str, values: Any) -> Any:
    def changed(table: pa.Table) -> pa.Table:
        return table.set_column(table.schema.names.index(name), name, values(table.column(name)))

    return changed


def nothing_in_first(column: pa.ChunkedArray) -> pa.Array:
    return pa.array([None, *column.to_pylist()[1:]], column.type)


def nan_in_first(column: pa.ChunkedArray) -> pa.Array:
    return pa.array([float("nan"), *column.to_pylist()[1:]], column.type)


WRONG = {
    "no description": (lambda t: t.replace_schema_metadata(None), "but not a table of motion that"),
    "another kind": (with_metadata(lambda about: about | {"kind": "steps"}), "but not a table of motion"),
    "a damaged description": (lambda t: t.replace_schema_metadata({METADATA_KEY: "{"}), "description of the table is"),
    "a description that is a list": (with_metadata(lambda about: [about]), "description of the table is damaged"),
    "another version": (with_metadata(lambda about: about | {"format_version": 9}), "expected table format 1, found 9"),
    "another layout": (with_metadata(lambda about: about | {"layout": {}}), "inputs and outputs have another layout"),
    "a missing column": (lambda table: table.drop_columns(["phase"]), "column 'phase' should be float, but is missing"),
    "a column of another type": (
        with_column("input.height_left.+0", lambda column: column.cast(pa.float64())),
        "column 'input.height_left.\\+0' should be float, but is double",
    ),
    "a missing value": (with_column("phase", nothing_in_first), "column 'phase' lacks 1 values"),
    "a NaN": (with_column("output.root_turn", nan_in_first), "y holds a value that is not finite, first in row 0"),
    "an unknown split": (
        with_column("split", lambda column: pa.array(["spare"] * len(column)).dictionary_encode()),
        "expected the splits train, validation, test, cycles, rows, found 'spare'",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("change", "message"), WRONG.values(), ids=WRONG.keys())
def test_what_is_wrong_with_a_table_is_one_clear_error(tmp_path: Path, table: Path, change: Any, message: str) -> None:
    pq.write_table(change(pq.read_table(table)), tmp_path / "part-0000.parquet")
    with pytest.raises(TableError, match=message) as found:
        load_motion(tmp_path)
    assert "part-0000.parquet" in str(found.value)
    assert "\n" not in str(found.value)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5, 0.7, 0.9, 0.97])
def test_damage_anywhere_is_an_error(tmp_path: Path, table: Path, share: float) -> None:
    content = bytearray(table.read_bytes())
    path = tmp_path / "part-0000.parquet"
    path.write_bytes(content[: int(len(content) * share)])
    with pytest.raises(TableError, match=r"part-0000\.parquet: expected a whole Parquet file, but it cannot be read"):
        load_motion(tmp_path)


def test_a_damaged_page_fails_its_checksum(tmp_path: Path, table: Path) -> None:
    content = bytearray(table.read_bytes())
    column = pq.ParquetFile(table).metadata.row_group(0).column(100)
    content[column.data_page_offset + column.total_compressed_size - 4] ^= 0xFF
    (tmp_path / "part-0000.parquet").write_bytes(content)
    with pytest.raises(TableError, match=r"part-0000\.parquet: expected a whole Parquet file"):
        load_motion(tmp_path)


def test_missing_tables_and_empty_splits_are_errors(tmp_path: Path, table: Path) -> None:
    with pytest.raises(TableError, match="expected Parquet files of motion, but there are none; run the convert stage"):
        load_motion(tmp_path)
    with pytest.raises(TableError, match=r"none\.parquet: no such table; run the convert stage first"):
        read_columns(tmp_path / "none.parquet", ["phase"])
    with pytest.raises(TableError, match="no row is in the split 'rows'; convert more clips or raise its share"):
        load_motion(table.parent, "rows")
