"""Motion <-> Parquet: one column for each input and output, readable by name in any tool; equal bytes for equal motion.

Each split has a folder of its own, so that one is read without the others.

The layout with its units and the format's version travel as JSON in the schema's metadata.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from jaxtyping import Int8

from addressed_dynamics.base.errors import MotionError, TableError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.layout import FRAME_RATE, INPUT, OUTPUT, Layout
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.episodes.parquet import METADATA_KEY, split_files
from addressed_dynamics.sources.motion.source import join_motion
from addressed_dynamics.sources.motion.splits import MOTION_SPLITS, MotionSplit

FORMAT_VERSION = 1
"""Version of the columns and metadata below; a reader refuses any other."""
FOLDER = "motion"
"""Folder of the files in an experiment's folder of tables."""
FILE_ROWS = 2**18
"""A file with so many rows, some 600 MB before compression, is followed by another."""
INPUTS = tuple(f"input.{name}" for name in INPUT.names)
"""Names of the columns of inputs, for instance `input.joint_velocity.Hips.x`."""
OUTPUTS = tuple(f"output.{name}" for name in OUTPUT.names)
"""Names of the columns of outputs, for instance `output.root_turn`."""
COUNTERS = ("frame", "cycle")

Write = Callable[[Motion, Int8[np.ndarray, " row"]], None]
"""Adds rows and the split of each, as an index into `MOTION_SPLITS`, to the tables."""


@contextmanager
def motion_writer(folder: Path, *, row_group_rows: int, file_rows: int = FILE_ROWS) -> Iterator[Write]:
    """Yield a function that adds rows to the files in `folder`, which appears when the block ends well.

    Each split has a folder of its own. A row group is written once there are enough rows for it, so that the rows in
    memory, beside those of one call, are never more than one row group has.

    Args:
        folder: folder of `train/part-0000.parquet` and so on; replaced whole.
        row_group_rows: most rows in a row group.
        file_rows: a file with so many rows gets no more.
    """
    with atomic_path(folder) as temporary, ExitStack() as stack:
        temporary.mkdir()
        splits: dict[int, _SplitFiles] = {}

        def write(motion: Motion, split: Int8[np.ndarray, " row"]) -> None:
            for code in np.unique(split).tolist():
                if code not in splits:
                    splits[code] = _SplitFiles(temporary, code, row_group_rows, file_rows)
                    stack.callback(splits[code].close)
                splits[code].add(motion.select(np.flatnonzero(split == code)))

        yield write
        for files in splits.values():
            files.flush()


class _SplitFiles:
    """The files of one split, one after the other."""

    def __init__(self, folder: Path, split: int, row_group_rows: int, file_rows: int) -> None:
        self._folder = folder / MOTION_SPLITS[split]
        self._split = split
        self._row_group_rows, self._file_rows = row_group_rows, file_rows
        self._writer: pq.ParquetWriter | None = None
        self._files, self._rows = 0, 0
        self._waiting, self._waiting_rows = list[Motion](), 0
        self._folder.mkdir()

    def add(self, motion: Motion) -> None:
        """Add rows; few of them wait for others: a row group has a header for each of a thousand columns."""
        self._waiting.append(motion)
        self._waiting_rows += len(motion)
        if self._waiting_rows * len(MOTION_SPLITS) >= self._row_group_rows:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait."""
        if not self._waiting:
            return
        motion = join_motion(self._waiting, self._waiting_rows)
        self._waiting, self._waiting_rows = [], 0
        if self._writer is None or self._rows >= self._file_rows:
            self.close()
            self._writer = _open_writer(self._folder / f"part-{self._files:04d}.parquet")
            self._files, self._rows = self._files + 1, 0
        split = np.full(len(motion), self._split, dtype=np.int8)
        self._writer.write_table(_table(motion, split), row_group_size=self._row_group_rows)
        self._rows += len(motion)

    def close(self) -> None:
        """Finish the file that is open."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None


def motion_files(folder: Path, split: MotionSplit | None = None) -> list[Path]:
    """Return the files of motion of an experiment's folder of tables, or of a folder of such files.

    Args:
        folder: the folder.
        split: the split that is wanted; None for all.

    Returns:
        The files of the split, by name; of all, split by split.

    Raises:
        TableError: there are no files of any split.
    """
    inner = folder / FOLDER if (folder / FOLDER).is_dir() else folder
    files = split_files(inner, MOTION_SPLITS, split)
    if not files and not split_files(inner, MOTION_SPLITS, None):
        message = f"{folder}: expected Parquet files of motion, but there are none; run the stage import_motion first"
        raise TableError(message)
    return files


def load_motion(folder: Path, split: MotionSplit | None = None) -> Motion:
    """Read all motion in `folder`, split by split, or that of one split without a look at the others.

    Never more is in memory than that and a row group.

    Args:
        folder: an experiment's folder of tables, for instance `data/tables/walking`.
        split: one of `MOTION_SPLITS`; None for all.

    Raises:
        TableError: a file is missing or damaged, or no row is in the split.
    """
    labels = _read_columns(motion_files(folder, split), ["split"])["split"]
    rows = len(labels) if split is None else int((labels == split).sum())
    if split is not None and not rows:
        message = f"{folder}: no row is in the split '{split}'; convert more clips or raise its share"
        raise TableError(message)
    return join_motion(stream_tables(folder, split), rows)


def stream_tables(folder: Path, split: MotionSplit | None = None) -> Iterator[Motion]:
    """Yield the motion in `folder`, split by split, or that of one split, a row group at a time.

    Raises:
        TableError: a file is missing or damaged.
    """
    for path in motion_files(folder, split):
        for table in _row_groups(path, None):
            rows = np.arange(table.num_rows) if split is None else np.flatnonzero(_texts(table, "split") == split)
            if len(rows) == table.num_rows:
                yield _motion(table, path)
            elif len(rows):
                yield _motion(table, path).select(rows)


def read_columns(path: Path, names: Sequence[str]) -> dict[str, np.ndarray[Any, Any]]:
    """Read some columns by name, of a file or of all files in a folder; texts for `clip` and `split`.

    Raises:
        TableError: a file is missing or damaged, or has no such column.
    """
    return _read_columns(motion_files(path) if path.is_dir() else [path], names)


def _read_columns(files: Sequence[Path], names: Sequence[str]) -> dict[str, np.ndarray[Any, Any]]:
    parts: dict[str, list[np.ndarray[Any, Any]]] = {name: [] for name in names}
    for file in files:
        for table in _row_groups(file, names):
            for name in names:
                is_text = pa.types.is_dictionary(TYPES[name])
                parts[name].append(_texts(table, name) if is_text else table.column(name).to_numpy())
    return {name: np.concatenate(arrays) if arrays else np.empty(0) for name, arrays in parts.items()}


def layout_to_json(layout: Layout) -> list[dict[str, Any]]:
    """Return the blocks of columns with their names and units."""
    return [{"block": block.name, "columns": list(block.columns), "unit": block.unit} for block in layout.blocks]


def _schema() -> pa.Schema:
    about = {
        "format_version": FORMAT_VERSION,
        "kind": "motion",
        "frame_rate": FRAME_RATE,
        "layout": {"input": layout_to_json(INPUT), "output": layout_to_json(OUTPUT)},
    }
    columns = [
        ("clip", pa.dictionary(pa.int32(), pa.string())),
        *((name, pa.int64()) for name in COUNTERS),
        ("split", pa.dictionary(pa.int8(), pa.string())),
        ("phase", pa.float32()),
        *((name, pa.float32()) for name in (*INPUTS, *OUTPUTS)),
    ]
    return pa.schema(columns, metadata={METADATA_KEY: json.dumps(about, sort_keys=True).encode()})


SCHEMA = _schema()
"""Columns of a table of motion, with the layout in its metadata."""
TYPES = dict(zip(SCHEMA.names, SCHEMA.types, strict=True))


def _open_writer(path: Path) -> pq.ParquetWriter:
    floats = [field.name for field in SCHEMA if field.type == pa.float32()]
    return pq.ParquetWriter(
        path,
        SCHEMA,
        compression="zstd",
        use_dictionary=["clip", "split"],
        column_encoding=dict.fromkeys(floats, "BYTE_STREAM_SPLIT") | dict.fromkeys(COUNTERS, "DELTA_BINARY_PACKED"),
        write_page_checksum=True,
    )


def _table(motion: Motion, split: Int8[np.ndarray, " row"]) -> pa.Table:
    clips, codes = np.unique(motion.clip, return_inverse=True)
    columns: dict[str, Any] = {
        "clip": pa.DictionaryArray.from_arrays(pa.array(codes.astype(np.int32)), clips.tolist()),
        "split": pa.DictionaryArray.from_arrays(pa.array(split, pa.int8()), list(MOTION_SPLITS)),
        "frame": motion.frame,
        "cycle": motion.cycle,
        "phase": motion.phase,
    }
    columns |= dict(zip(INPUTS, np.ascontiguousarray(motion.x.T), strict=True))
    columns |= dict(zip(OUTPUTS, np.ascontiguousarray(motion.y.T), strict=True))
    return pa.table(columns, schema=SCHEMA)


def _row_groups(path: Path, names: Sequence[str] | None) -> Iterator[pa.Table]:
    """Yield the row groups of a file, with all columns or some."""
    try:
        with pq.ParquetFile(path, page_checksum_verification=True) as file:
            _check_metadata(file.schema_arrow, path)
            _check_columns(file.schema_arrow, SCHEMA.names if names is None else names, path)
            for group in range(file.num_row_groups):
                table = file.read_row_group(group, columns=None if names is None else list(names))
                _check_values(table, path)
                yield table
    except FileNotFoundError as error:
        message = f"{path}: no such table; run the stage import_motion first"
        raise TableError(message) from error
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        reason = str(error).split("\n", maxsplit=1)[0]
        message = f"{path}: expected a whole Parquet file, but it cannot be read ({reason}); run import_motion again"
        raise TableError(message) from error


def _check_metadata(found: pa.Schema, path: Path) -> None:
    text = (found.metadata or {}).get(METADATA_KEY)
    expected = json.loads(SCHEMA.metadata[METADATA_KEY])
    try:
        about = json.loads(text) if text is not None else {}
        version = about.get("format_version")
    except (ValueError, AttributeError) as error:
        message = f"{path}: the description of the table is damaged; run import_motion again"
        raise TableError(message) from error
    if about.get("kind") != expected["kind"]:
        message = f"{path}: a Parquet file, but not a table of motion that import_motion wrote"
        raise TableError(message)
    if version != FORMAT_VERSION:
        message = f"{path}: expected table format {FORMAT_VERSION}, found {version!r}; run this version's import_motion"
        raise TableError(message)
    if about != expected:
        message = f"{path}: its inputs and outputs have another layout; run this version's import_motion"
        raise TableError(message)


def _check_columns(found: pa.Schema, names: Sequence[str], path: Path) -> None:
    types = dict(zip(found.names, found.types, strict=True))
    for name in names:
        if name not in TYPES:
            message = f"{path}: a table of motion has no column '{name}'; for instance, it has '{INPUTS[0]}'"
            raise TableError(message)
        expected, kind = TYPES[name], types.get(name)
        # Parquet keeps the strings of a dictionary, not the width of its indices.
        is_label = pa.types.is_dictionary(expected) and kind is not None and pa.types.is_dictionary(kind)
        if kind != expected and not is_label:
            what = "is missing" if kind is None else f"is {kind}"
            message = f"{path}: column '{name}' should be {expected}, but {what}; run import_motion again"
            raise TableError(message)


def _check_values(table: pa.Table, path: Path) -> None:
    for name, column in zip(table.column_names, table.columns, strict=True):
        if missing := column.null_count:
            message = f"{path}: column '{name}' lacks {missing} values; run import_motion again"
            raise TableError(message)
    if "split" in table.column_names:
        unknown = sorted(set(table.column("split").unique().to_pylist()) - set(MOTION_SPLITS))
        if unknown:
            expected = ", ".join(MOTION_SPLITS)
            message = f"{path}: expected the splits {expected}, found '{unknown[0]}'; run import_motion again"
            raise TableError(message)


def _motion(table: pa.Table, path: Path) -> Motion:
    arrays = {name: table.column(name).to_numpy() for name in ("phase", *COUNTERS)}
    try:
        return Motion(x=_stack(table, INPUTS), y=_stack(table, OUTPUTS), clip=_texts(table, "clip"), **arrays)
    except MotionError as error:
        message = f"{path}: {error}; run import_motion again"
        raise TableError(message) from error


def _stack(table: pa.Table, names: Sequence[str]) -> np.ndarray[Any, Any]:
    stacked = np.empty((table.num_rows, len(names)), dtype=np.float32)
    for index, name in enumerate(names):
        stacked[:, index] = table.column(name).to_numpy()
    return stacked


def _texts(table: pa.Table, name: str) -> np.ndarray[Any, Any]:
    column = table.column(name).unify_dictionaries().combine_chunks()
    if not len(column):
        return np.empty(0, dtype="U1")
    texts: np.ndarray[Any, Any] = np.array(column.dictionary.to_pylist())[column.indices.to_numpy()]
    return texts
