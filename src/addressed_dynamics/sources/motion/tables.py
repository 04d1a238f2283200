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
from addressed_dynamics.episodes.tables import (
    AGAIN,
    METADATA_KEY,
    check_splits,
    described,
    description,
    files_of_kind,
    open_writer,
    read_row_groups,
    stack,
    texts,
)
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
            self._writer = open_writer(self._folder / f"part-{self._files:04d}.parquet", SCHEMA, COUNTERS)
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
    """Return the files of motion in a folder; see `files_of_kind`."""
    return files_of_kind(folder, FOLDER, MOTION_SPLITS, split)


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
            rows = np.arange(table.num_rows) if split is None else np.flatnonzero(texts(table, "split") == split)
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
                parts[name].append(texts(table, name) if is_text else table.column(name).to_numpy())
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
    return described(columns, about)


SCHEMA = _schema()
"""Columns of a table of motion, with the layout in its metadata."""
TYPES = dict(zip(SCHEMA.names, SCHEMA.types, strict=True))


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
    for table in read_row_groups(path, names, _expected):
        if "split" in table.column_names:
            check_splits(table, MOTION_SPLITS, path)
        yield table


def _expected(found: pa.Schema, path: Path) -> pa.Schema:
    """Check that a file is of this layout; return its schema."""
    if description(found, path, "motion", FORMAT_VERSION) != json.loads(SCHEMA.metadata[METADATA_KEY]):
        message = f"{path}: its inputs and outputs have another layout; run the convert stage of this version"
        raise TableError(message)
    return SCHEMA


def _motion(table: pa.Table, path: Path) -> Motion:
    arrays = {name: table.column(name).to_numpy() for name in ("phase", *COUNTERS)}
    try:
        return Motion(x=stack(table, INPUTS), y=stack(table, OUTPUTS), clip=texts(table, "clip"), **arrays)
    except MotionError as error:
        message = f"{path}: {error}; {AGAIN}"
        raise TableError(message) from error
