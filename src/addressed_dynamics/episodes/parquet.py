"""Transitions <-> Parquet: one column per dimension, readable by name in any tool; the same table gives the same bytes.

Spaces and the format's version travel as JSON in the schema's metadata. Each file holds episodes of one segment. Each
split has a folder of its own, `train`, `validation` or `test`, so that one is read without the others.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Int8

from addressed_dynamics.base.errors import TableError, TransitionsError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.splits import SPLITS, Split
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec, Transitions

FORMAT_VERSION = 1
"""Version of the columns and metadata below; a reader refuses any other."""
FOLDER = "transitions"
"""Folder of the files in an experiment's folder of tables."""
METADATA_KEY = b"addressed_dynamics"
"""Key of our JSON in the schema's metadata."""
SCALARS = {
    "episode": pa.int64(),
    "step": pa.int32(),
    "time_ns": pa.int64(),
    "reward": pa.float32(),
    "terminated": pa.bool_(),
    "truncated": pa.bool_(),
}
"""Columns that are the same for every environment."""
LABEL = pa.dictionary(pa.int8(), pa.string())


@dataclass(frozen=True)
class TransitionTable:
    """The transitions of one Parquet file, with what only tables know about them."""

    transitions: Transitions
    """The transitions, in episode order."""
    split: Int8[np.ndarray, " step"]
    """Index into `SPLITS` of each transition; one value per episode."""
    segment: str
    """Name of the part of the recording plan that all of them come from."""

    def only(self, split: Split) -> Transitions:
        """Return the transitions of the episodes in `split`."""
        return self.transitions.select(self.split == SPLITS.index(split))


def write_table(path: Path, table: TransitionTable, *, row_group_rows: int) -> None:
    """Write `table` to `path`, atomically, in row groups of `row_group_rows` rows."""
    with table_writer(path, table.transitions.spec, row_group_rows=row_group_rows) as write:
        write(table)


@contextmanager
def table_writer(path: Path, spec: SpaceSpec, *, row_group_rows: int) -> Iterator[Callable[[TransitionTable], None]]:
    """Yield a function that adds a table to the file at `path`, which appears when the block ends well.

    The tables are of these spaces and of one segment; each begins a row group.
    """
    schema = _schema(spec)
    floats = [field.name for field in schema if field.type == pa.float32()]
    counters = ["episode", "step", "time_ns"]
    with (
        atomic_path(path) as temporary,
        pq.ParquetWriter(
            temporary,
            schema,
            compression="zstd",
            use_dictionary=[name for name in ("action", "split", "segment") if name in schema.names],
            column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT") | dict.fromkeys(counters, "DELTA_BINARY_PACKED"),
            write_page_checksum=True,
        ) as writer,
    ):

        def write(table: TransitionTable) -> None:
            writer.write_table(pa.table(_columns(table), schema=schema), row_group_size=row_group_rows)

        yield write


@contextmanager
def split_writer(
    folder: Path, name: str, spec: SpaceSpec, *, row_group_rows: int
) -> Iterator[Callable[[TransitionTable], None]]:
    """Yield a function that adds the rows of a table to the file `name` of their split: `train/name` and so on.

    The files appear in `folder` when the block ends well; a split without rows gets none. The tables are of these
    spaces and of one segment; of each, the rows of a split begin a row group.
    """
    with ExitStack() as stack:
        writers: dict[int, Callable[[TransitionTable], None]] = {}

        def write(table: TransitionTable) -> None:
            for code in np.unique(table.split).tolist():
                if code not in writers:
                    path = folder / SPLITS[code] / name
                    writers[code] = stack.enter_context(table_writer(path, spec, row_group_rows=row_group_rows))
                rows = table.split == code
                part = TransitionTable(table.transitions.select(rows), table.split[rows], table.segment)
                writers[code](part)

        yield write


def split_files(folder: Path, splits: Sequence[str], split: str | None) -> list[Path]:
    """Return the Parquet files in `folder` that hold a split, or all: split by split, and in each by name.

    Without folders called like the splits, they are the files in `folder` itself: any of them may hold rows of any
    split.
    """
    if not any((folder / name).is_dir() for name in splits):
        return sorted(folder.glob("*.parquet"))
    wanted = splits if split is None else (split,)
    return [file for name in wanted for file in sorted((folder / name).glob("*.parquet"))]


def read_table(path: Path) -> TransitionTable:
    """Read what `write_table` wrote, and check it.

    Raises:
        TableError: the file is missing, damaged, of another format version, lacks a column or has one of another
            type, or holds missing values, NaNs or broken episodes.
    """
    table = _read_arrow(path)
    spec = _spec(table.schema, path)
    _check_schema(table, _schema(spec), path)
    try:
        transitions = Transitions(spec=spec, **_arrays(table, spec))
    except TransitionsError as error:
        message = f"{path}: {error}; run the convert stage again"
        raise TableError(message) from error
    return TransitionTable(transitions=transitions, split=_split(table, path), segment=_segment(table, path))


def table_files(folder: Path, split: Split | None = None) -> list[Path]:
    """Return the files of transitions of an experiment's folder of tables, or of a folder of such files.

    Args:
        folder: the folder.
        split: the split that is wanted; None for all.

    Returns:
        The files of the split, by name; of all, split by split.

    Raises:
        TableError: there are no files of any split.
    """
    inner = folder / FOLDER if (folder / FOLDER).is_dir() else folder
    files = split_files(inner, SPLITS, split)
    if not files and not split_files(inner, SPLITS, None):
        message = f"{folder}: expected Parquet files of transitions, but there are none; run the convert stage first"
        raise TableError(message)
    return files


def load_transitions(folder: Path, split: Split | None = None) -> Transitions:
    """Read all transitions in `folder`, or those of one split without a look at the others.

    They come file by file, each the table of a log, and of all splits in the order of the episodes' numbers there.

    Args:
        folder: an experiment's folder of tables, for instance `data/tables/mountaincar`.
        split: `train`, `validation` or `test`; None for all.

    Raises:
        TableError: a file is missing or damaged, or no episode is in the split.
    """
    by_log: dict[str, list[Transitions]] = {}
    for path in table_files(folder, split):
        table = read_table(path)
        by_log.setdefault(path.name, []).append(table.transitions if split is None else table.only(split))
    if split is not None and not any(len(part) for parts in by_log.values() for part in parts):
        message = f"{folder}: no episode is in the split '{split}'; record more episodes or raise convert.{split}_share"
        raise TableError(message)
    try:
        transitions = Transitions.concatenate([_in_order(by_log[name]) for name in sorted(by_log)])
    except TransitionsError as error:
        message = f"{folder}: {error}"
        raise TableError(message) from error
    return transitions


def _in_order(parts: Sequence[Transitions]) -> Transitions:
    """Put the episodes of a log that several splits hold together again."""
    if len(parts) == 1:
        return parts[0]
    whole = Transitions.concatenate(parts)
    return whole.select(np.argsort(whole.episode, kind="stable"))


def _schema(spec: SpaceSpec) -> pa.Schema:
    action = (
        [(name, pa.float32()) for name in _names("action", spec.action.dimensions)]
        if isinstance(spec.action, ContinuousAction)
        else [("action", pa.int64())]
    )
    columns = [
        *((name, SCALARS[name]) for name in ("episode", "step", "time_ns")),
        *((name, pa.float32()) for name in _names("observation", spec.observation)),
        *action,
        ("reward", SCALARS["reward"]),
        *((name, pa.float32()) for name in _names("next_observation", spec.observation)),
        *((name, SCALARS[name]) for name in ("terminated", "truncated")),
        ("split", LABEL),
        ("segment", LABEL),
    ]
    about = {"format_version": FORMAT_VERSION, "spaces": spec.to_json()}
    return pa.schema(columns, metadata={METADATA_KEY: json.dumps(about, sort_keys=True).encode()})


def _names(prefix: str, dimensions: tuple[Dimension, ...]) -> list[str]:
    return [f"{prefix}.{dimension.name}" for dimension in dimensions]


def _columns(table: TransitionTable) -> dict[str, Any]:
    transitions, spec = table.transitions, table.transitions.spec
    columns: dict[str, Any] = {name: getattr(transitions, name) for name in SCALARS}
    columns |= dict(zip(_names("observation", spec.observation), transitions.observation.T, strict=True))
    columns |= dict(zip(_names("next_observation", spec.observation), transitions.next_observation.T, strict=True))
    if isinstance(spec.action, ContinuousAction):
        columns |= dict(zip(_names("action", spec.action.dimensions), transitions.action.T, strict=True))
    else:
        columns["action"] = transitions.action
    columns["split"] = pa.DictionaryArray.from_arrays(pa.array(table.split, pa.int8()), list(SPLITS))
    codes = pa.array(np.zeros(len(transitions), dtype=np.int8))
    columns["segment"] = pa.DictionaryArray.from_arrays(codes, [table.segment])
    return columns


def _read_arrow(path: Path) -> pa.Table:
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            return file.read()
    except FileNotFoundError as error:
        message = f"{path}: no such table; run the convert stage first"
        raise TableError(message) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = (
            f"{path}: expected a whole Parquet file, but it cannot be read ({reason}); run the convert stage again"
        )
        raise TableError(message) from error


def _spec(schema: pa.Schema, path: Path) -> SpaceSpec:
    text = (schema.metadata or {}).get(METADATA_KEY)
    if text is None:
        message = f"{path}: a Parquet file, but not a table of transitions that the convert stage wrote"
        raise TableError(message)
    try:
        about = json.loads(text)
        version = about["format_version"]
    except (ValueError, KeyError, TypeError) as error:
        message = f"{path}: the description of the table is damaged; run the convert stage again"
        raise TableError(message) from error
    if version != FORMAT_VERSION:
        message = (
            f"{path}: expected table format {FORMAT_VERSION}, found {version!r}; run the convert stage of this version"
        )
        raise TableError(message)
    try:
        return SpaceSpec.from_json(about.get("spaces"))
    except TransitionsError as error:
        message = f"{path}: {error}; run the convert stage again"
        raise TableError(message) from error


def _check_schema(table: pa.Table, expected: pa.Schema, path: Path) -> None:
    for field in expected:
        found = table.schema.field(field.name).type if field.name in table.schema.names else None
        same = found == field.type or (pa.types.is_dictionary(field.type) and _is_label(found))
        if not same:
            what = "is missing" if found is None else f"is {found}"
            message = f"{path}: column '{field.name}' should be {field.type}, but {what}; run the convert stage again"
            raise TableError(message)
        if missing := table.column(field.name).null_count:
            message = f"{path}: column '{field.name}' lacks {missing} values; run the convert stage again"
            raise TableError(message)


def _is_label(found: pa.DataType | None) -> bool:
    # Parquet keeps the strings of a dictionary, not the width of its indices.
    return found is not None and pa.types.is_dictionary(found) and found.value_type == pa.string()


def _arrays(table: pa.Table, spec: SpaceSpec) -> dict[str, Any]:
    arrays = {name: table.column(name).to_numpy() for name in SCALARS}
    for name in ("observation", "next_observation"):
        arrays[name] = _stack(table, _names(name, spec.observation))
    if isinstance(spec.action, ContinuousAction):
        arrays["action"] = _stack(table, _names("action", spec.action.dimensions))
    else:
        arrays["action"] = table.column("action").to_numpy()
    return arrays


def _stack(table: pa.Table, names: list[str]) -> np.ndarray[Any, Any]:
    stacked = np.empty((table.num_rows, len(names)), dtype=np.float32)
    for index, name in enumerate(names):
        stacked[:, index] = table.column(name).to_numpy()
    return stacked


def _split(table: pa.Table, path: Path) -> Int8[np.ndarray, " step"]:
    column = table.column("split").unify_dictionaries().combine_chunks()
    labels = column.dictionary.to_pylist() if len(column) else []
    if unknown := sorted(set(labels) - set(SPLITS)):
        message = f"{path}: expected the splits {', '.join(SPLITS)}, found '{unknown[0]}'; run the convert stage again"
        raise TableError(message)
    to_index = np.array([SPLITS.index(label) for label in labels], dtype=np.int8)
    indices = column.indices.to_numpy() if len(column) else np.empty(0, dtype=np.int64)
    return to_index[indices] if len(labels) else np.empty(0, dtype=np.int8)


def _segment(table: pa.Table, path: Path) -> str:
    segments = table.column("segment").unique().to_pylist()
    if len(segments) != 1:
        message = f"{path}: expected rows of one segment, found {len(segments)} segments; run the convert stage again"
        raise TableError(message)
    return str(segments[0])
