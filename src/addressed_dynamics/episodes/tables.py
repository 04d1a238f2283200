"""Parquet as all kinds of data are kept in it: typed columns, a description in the metadata, checked when it is read.

Equal tables give equal bytes. Each split has a folder of its own, so that one is read without the others.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Int8

from addressed_dynamics.base.errors import TableError

METADATA_KEY = b"addressed_dynamics"
"""Key of our JSON in a schema's metadata."""
AGAIN = "run the convert stage again"
"""What helps where a table is not what that stage writes."""


def described(columns: Sequence[tuple[str, pa.DataType]], about: Mapping[str, Any]) -> pa.Schema:
    """Return a schema with a JSON-compatible description in its metadata."""
    return pa.schema(columns, metadata={METADATA_KEY: json.dumps(about, sort_keys=True).encode()})


def open_writer(path: Path, schema: pa.Schema, counters: Sequence[str]) -> pq.ParquetWriter:
    """Open a file: floats split by bytes, counters by differences, labels and discrete actions as a dictionary."""
    floats = [field.name for field in schema if field.type == pa.float32()]
    labels = [field.name for field in schema if pa.types.is_dictionary(field.type) or field.name == "action"]
    return pq.ParquetWriter(
        path,
        schema,
        compression="zstd",
        use_dictionary=labels,
        column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT") | dict.fromkeys(counters, "DELTA_BINARY_PACKED"),
        write_page_checksum=True,
    )


def split_files(folder: Path, splits: Sequence[str], split: str | None) -> list[Path]:
    """Return the Parquet files in `folder` that hold a split, or all: split by split, and in each by name.

    Without folders called like the splits, they are the files in `folder` itself: any of them may hold rows of any
    split.
    """
    if not any((folder / name).is_dir() for name in splits):
        return sorted(folder.glob("*.parquet"))
    wanted = splits if split is None else (split,)
    return [file for name in wanted for file in sorted((folder / name).glob("*.parquet"))]


def files_of_kind(folder: Path, inner: str, splits: Sequence[str], split: str | None) -> list[Path]:
    """Return the files of a kind of data in an experiment's folder of tables, or in a folder of such files.

    Args:
        folder: the folder.
        inner: name of the folder of this kind in it.
        splits: the splits of the kind.
        split: the split that is wanted; None for all.

    Returns:
        The files of the split, by name; of all, split by split.

    Raises:
        TableError: there are no files of any split.
    """
    place = folder / inner if (folder / inner).is_dir() else folder
    files = split_files(place, splits, split)
    if not files and not split_files(place, splits, None):
        message = f"{folder}: expected Parquet files of {inner}, but there are none; run the convert stage first"
        raise TableError(message)
    return files


def read_row_groups(
    path: Path, names: Sequence[str] | None, expected: Callable[[pa.Schema, Path], pa.Schema]
) -> Iterator[pa.Table]:
    """Yield the row groups of a file, with all columns or those called so.

    Args:
        path: the file.
        names: columns that are wanted; None for all.
        expected: takes the schema that was found and the path; returns the schema that the file should have, or raises
            a `TableError`.

    Raises:
        TableError: the file is missing or damaged, lacks a column, has one of another type, or lacks values.
    """
    with _readable(path), pq.ParquetFile(path, page_checksum_verification=True) as file:
        _check_columns(file.schema_arrow, expected(file.schema_arrow, path), names, path)
        for group in range(file.num_row_groups):
            table = file.read_row_group(group, columns=None if names is None else list(names))
            _check_whole(table, path)
            yield table


def row_count(path: Path) -> int:
    """Return the number of rows of a file, which is not read.

    Raises:
        TableError: the file is missing or damaged.
    """
    with _readable(path):
        return int(pq.read_metadata(path).num_rows)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Say what is wrong with a file that cannot be read."""
    try:
        yield
    except FileNotFoundError as error:
        message = f"{path}: no such table; run the convert stage first"
        raise TableError(message) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"{path}: expected a whole Parquet file, but it cannot be read ({reason}); {AGAIN}"
        raise TableError(message) from error


def description(schema: pa.Schema, path: Path, kind: str, version: int) -> dict[str, Any]:
    """Return the description in a schema, which should be of a kind of table and of a version of its format.

    Raises:
        TableError: it is not.
    """
    text = (schema.metadata or {}).get(METADATA_KEY)
    try:
        about = json.loads(text) if text is not None else {}
        found = about.get("format_version")
    except (ValueError, AttributeError) as error:
        message = f"{path}: the description of the table is damaged; {AGAIN}"
        raise TableError(message) from error
    if text is None or about.get("kind", "transitions") != kind:
        message = f"{path}: a Parquet file, but not a table of {kind} that the convert stage wrote"
        raise TableError(message)
    if found != version:
        message = f"{path}: expected table format {version}, found {found!r}; run the convert stage of this version"
        raise TableError(message)
    return dict(about)


def stack(table: pa.Table, names: Sequence[str]) -> np.ndarray[Any, Any]:
    """Return columns of floats side by side, (row, column)."""
    stacked = np.empty((table.num_rows, len(names)), dtype=np.float32)
    for index, name in enumerate(names):
        stacked[:, index] = table.column(name).to_numpy()
    return stacked


def texts(table: pa.Table, name: str) -> np.ndarray[Any, Any]:
    """Return a column of labels as texts."""
    column = table.column(name).unify_dictionaries().combine_chunks()
    if not len(column):
        return np.empty(0, dtype="U1")
    found: np.ndarray[Any, Any] = np.array(column.dictionary.to_pylist())[column.indices.to_numpy()]
    return found


def codes(table: pa.Table, name: str, labels: Sequence[str]) -> Int8[np.ndarray, " row"]:
    """Return the labels of a column, all of which are known, as indices into `labels`."""
    column = table.column(name).unify_dictionaries().combine_chunks()
    if not len(column):
        return np.empty(0, dtype=np.int8)
    index = np.array([labels.index(label) for label in column.dictionary.to_pylist()], dtype=np.int8)
    found: Int8[np.ndarray, " row"] = index[column.indices.to_numpy()]
    return found


def check_splits(table: pa.Table, splits: Sequence[str], path: Path) -> None:
    """Check that the column `split` holds these splits alone.

    Raises:
        TableError: it holds another.
    """
    unknown = sorted(set(table.column("split").unique().to_pylist()) - set(splits))
    if unknown:
        message = f"{path}: expected the splits {', '.join(splits)}, found '{unknown[0]}'; {AGAIN}"
        raise TableError(message)


def _check_columns(found: pa.Schema, expected: pa.Schema, names: Sequence[str] | None, path: Path) -> None:
    types = dict(zip(found.names, found.types, strict=True))
    for name in expected.names if names is None else names:
        if name not in expected.names:
            message = (
                f"{path}: there is no column '{name}' in such a table; for instance, it has '{expected.names[-1]}'"
            )
            raise TableError(message)
        kind, wanted = types.get(name), expected.field(name).type
        # Parquet keeps the strings of a dictionary, not the width of its indices.
        labels = [each.value_type for each in (kind, wanted) if each is not None and pa.types.is_dictionary(each)]
        if kind != wanted and labels != [pa.string(), pa.string()]:
            what = "is missing" if kind is None else f"is {kind}"
            message = f"{path}: column '{name}' should be {wanted}, but {what}; {AGAIN}"
            raise TableError(message)


def _check_whole(table: pa.Table, path: Path) -> None:
    for name, column in zip(table.column_names, table.columns, strict=True):
        if missing := column.null_count:
            message = f"{path}: column '{name}' lacks {missing} values; {AGAIN}"
            raise TableError(message)
