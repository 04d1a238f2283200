"""Transitions <-> Parquet: one column per dimension, readable by name in any tool; the same table gives the same bytes.

Spaces and the format's version travel as JSON in the schema's metadata. Each file holds episodes of one segment. Each
split has a folder of its own, `train`, `validation` or `test`, so that one is read without the others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from jaxtyping import Int8, Int64

from addressed_dynamics.base.errors import TableError, TransitionsError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.splits import SPLITS, Split
from addressed_dynamics.episodes.tables import (
    AGAIN,
    check_splits,
    codes,
    described,
    description,
    files_of_kind,
    open_writer,
    read_row_groups,
    row_count,
    stack,
)
from addressed_dynamics.episodes.transitions import COLUMNS, ContinuousAction, Dimension, SpaceSpec, Transitions

FORMAT_VERSION = 1
"""Version of the columns and metadata below; a reader refuses any other."""
FOLDER = "transitions"
"""Folder of the files in an experiment's folder of tables."""
SCALARS = {
    "episode": pa.int64(),
    "step": pa.int32(),
    "time_ns": pa.int64(),
    "reward": pa.float32(),
    "terminated": pa.bool_(),
    "truncated": pa.bool_(),
}
"""Columns that are the same for every environment."""
COUNTERS = ("episode", "step", "time_ns")
LABEL = pa.dictionary(pa.int8(), pa.string())
Make = Callable[[tuple[int, ...], Any], np.ndarray]
"""Makes an empty array (shape, dtype); where it lies is up to it."""


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
    with atomic_path(path) as temporary, open_writer(temporary, schema, COUNTERS) as writer:

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


def read_table(path: Path) -> TransitionTable:
    """Read what `write_table` wrote, and check it.

    Raises:
        TableError: the file is missing, damaged, of another format version, lacks a column or has one of another
            type, or holds missing values, NaNs or broken episodes.
    """
    specs: list[SpaceSpec] = []
    groups = [*_row_groups(path, specs)]
    return _table(pa.concat_tables(groups) if groups else _schema(specs[0]).empty_table(), specs[0], path)


def read_parts(path: Path) -> Iterator[TransitionTable]:
    """Yield what `read_table` returns, a row group at a time.

    Raises:
        TableError: as in `read_table`; each part is checked by itself.
    """
    specs: list[SpaceSpec] = []
    for group in _row_groups(path, specs):
        yield _table(group, specs[0], path)


def _row_groups(path: Path, specs: list[SpaceSpec]) -> Iterator[pa.Table]:
    def expected(schema: pa.Schema, path: Path) -> pa.Schema:
        specs.append(_spec(schema, path))
        return _schema(specs[0])

    return read_row_groups(path, None, expected)


def _table(table: pa.Table, spec: SpaceSpec, path: Path) -> TransitionTable:
    check_splits(table, SPLITS, path)
    try:
        transitions = Transitions(spec=spec, **_arrays(table, spec))
    except TransitionsError as error:
        message = f"{path}: {error}; {AGAIN}"
        raise TableError(message) from error
    split = codes(table, "split", SPLITS)
    return TransitionTable(transitions=transitions, split=split, segment=_segment(table, path))


def table_files(folder: Path, split: Split | None = None) -> list[Path]:
    """Return the files of transitions in a folder; see `files_of_kind`."""
    return files_of_kind(folder, FOLDER, SPLITS, split)


def load_transitions(folder: Path, split: Split | None = None, *, make: Make = np.empty) -> Transitions:
    """Read all transitions in `folder`, or those of one split without a look at the others.

    They come file by file, each the table of a log, and of all splits in the order of the episodes' numbers there.

    Args:
        folder: an experiment's folder of tables, for instance `data/tables/mountaincar`.
        split: `train`, `validation` or `test`; None for all.
        make: makes the columns of a split (shape, dtype).

    Raises:
        TableError: a file is missing or damaged, or no episode is in the split.
    """
    if split is not None:
        stream = TransitionStream(folder, split)
        return joined(stream, stream.rows, make)
    by_log: dict[str, list[Transitions]] = {}
    for path in table_files(folder, split):
        by_log.setdefault(path.name, []).append(read_table(path).transitions)
    try:
        transitions = Transitions.concatenate([_in_order(by_log[name]) for name in sorted(by_log)])
    except TransitionsError as error:
        message = f"{folder}: {error}"
        raise TableError(message) from error
    return transitions


def joined(parts: Iterable[Transitions], rows: int, make: Make = np.empty) -> Transitions:
    """Return transitions that come in parts as a whole; no more than a part is in memory beside the columns.

    Args:
        parts: at least one.
        rows: as many as they have together, or more.
        make: makes the columns (shape, dtype).

    Raises:
        TransitionsError: an episode is not whole, or in two places.
    """
    columns, count = dict[str, np.ndarray](), 0
    for part in parts:
        for name in COLUMNS:
            values = getattr(part, name)
            if name not in columns:
                columns[name] = make((rows, *values.shape[1:]), values.dtype)
            columns[name][count : count + len(part)] = values
        count += len(part)
        spec = part.spec
    return Transitions(spec=spec, **{name: values[:count] for name, values in columns.items()})


def _none_in(folder: Path, split: Split) -> TableError:
    return TableError(
        f"{folder}: no episode is in the split '{split}'; record more episodes or raise convert.{split}_share"
    )


@dataclass(frozen=True)
class TransitionStream:
    """The transitions of a split, to be read again and again, a row group at a time; see `load_transitions`.

    A part may end inside an episode. That episodes are whole and unique is checked as they pass.

    Raises:
        TableError: while they are read, as in `load_transitions`.
    """

    folder: Path
    """An experiment's folder of tables."""
    split: Split
    """Which of its splits."""

    @cached_property
    def rows(self) -> int:
        """Rows of the files: as many as there are transitions, or more, if files hold several splits."""
        return sum(row_count(path) for path in table_files(self.folder, self.split))

    @cached_property
    def spec(self) -> SpaceSpec:
        """Names, units and bounds of the transitions."""
        return next(iter(self)).spec

    def digest(self) -> str:
        """Return a hash of the names and bytes of the files."""
        digest = hashlib.blake2b(self.split.encode(), digest_size=16)
        for path in table_files(self.folder, self.split):
            with path.open("rb") as file:
                digest.update(f"{path.name} {hashlib.file_digest(file, 'blake2b').hexdigest()}\n".encode())
        return digest.hexdigest()

    def __iter__(self) -> Iterator[Transitions]:
        last, episodes = None, list[Int64[np.ndarray, " episode"]]()
        try:
            for part in self._parts():
                begins = part.episode[np.append(True, part.episode[1:] != part.episode[:-1])]
                if last is not None:
                    # Of the row before and the first one, all that holds of two rows in a table.
                    Transitions.concatenate([last, part.select(slice(1))])
                    begins = begins[int(begins[0] == last.episode[0]) :]
                episodes.append(begins)
                last = part.select(slice(-1, None))
                yield part
            found, counts = np.unique(np.concatenate(episodes or [np.empty(0, np.int64)]), return_counts=True)
            if (counts > 1).any():
                message = f"episode {found[counts > 1][0]} is in two places, or two recordings share the number"
                raise TransitionsError(message)
        except TransitionsError as error:
            message = f"{self.folder}: {error}"
            raise TableError(message) from error
        if last is None:
            raise _none_in(self.folder, self.split)

    def _parts(self) -> Iterator[Transitions]:
        for path in table_files(self.folder, self.split):
            for table in read_parts(path):
                if len(part := table.only(self.split)):
                    yield part


def _in_order(parts: Sequence[Transitions]) -> Transitions:
    """Put the episodes of a log that several splits hold together again."""
    if len(parts) == 1:
        return parts[0]
    whole = Transitions.concatenate(parts)
    return whole.select(np.argsort(whole.episode, kind="stable"))


def _schema(spec: SpaceSpec) -> pa.Schema:
    action = (
        [(name, pa.float32()) for name in column_names("action", spec.action.dimensions)]
        if isinstance(spec.action, ContinuousAction)
        else [("action", pa.int64())]
    )
    columns = [
        *((name, SCALARS[name]) for name in COUNTERS),
        *((name, pa.float32()) for name in column_names("observation", spec.observation)),
        *action,
        *((name, pa.float32()) for name in column_names("exogenous", spec.exogenous)),
        ("reward", SCALARS["reward"]),
        *((name, pa.float32()) for name in column_names("next_observation", spec.observation)),
        *((name, SCALARS[name]) for name in ("terminated", "truncated")),
        ("split", LABEL),
        ("segment", LABEL),
    ]
    about = {"format_version": FORMAT_VERSION, "spaces": spec.to_json()}
    return described(columns, about)


def column_names(role: str, dimensions: tuple[Dimension, ...]) -> list[str]:
    """Return what the columns of dimensions are called: `observation.position`, where `observation` is the role."""
    return [f"{role}.{dimension.name}" for dimension in dimensions]


def _columns(table: TransitionTable) -> dict[str, Any]:
    transitions, spec = table.transitions, table.transitions.spec
    columns: dict[str, Any] = {name: getattr(transitions, name) for name in SCALARS}
    columns |= dict(zip(column_names("observation", spec.observation), transitions.observation.T, strict=True))
    columns |= dict(
        zip(column_names("next_observation", spec.observation), transitions.next_observation.T, strict=True)
    )
    if isinstance(spec.action, ContinuousAction):
        columns |= dict(zip(column_names("action", spec.action.dimensions), transitions.action.T, strict=True))
    else:
        columns["action"] = transitions.action
    columns |= dict(zip(column_names("exogenous", spec.exogenous), transitions.exogenous.T, strict=True))
    columns["split"] = pa.DictionaryArray.from_arrays(pa.array(table.split, pa.int8()), list(SPLITS))
    codes = pa.array(np.zeros(len(transitions), dtype=np.int8))
    columns["segment"] = pa.DictionaryArray.from_arrays(codes, [table.segment])
    return columns


def _spec(schema: pa.Schema, path: Path) -> SpaceSpec:
    try:
        return SpaceSpec.from_json(description(schema, path, "transitions", FORMAT_VERSION).get("spaces"))
    except TransitionsError as error:
        message = f"{path}: {error}; {AGAIN}"
        raise TableError(message) from error


def _arrays(table: pa.Table, spec: SpaceSpec) -> dict[str, Any]:
    arrays = {name: table.column(name).to_numpy() for name in SCALARS}
    for name in ("observation", "next_observation"):
        arrays[name] = stack(table, column_names(name, spec.observation))
    if isinstance(spec.action, ContinuousAction):
        arrays["action"] = stack(table, column_names("action", spec.action.dimensions))
    else:
        arrays["action"] = table.column("action").to_numpy()
    arrays["exogenous"] = stack(table, column_names("exogenous", spec.exogenous))
    return arrays


def _segment(table: pa.Table, path: Path) -> str:
    segments = table.column("segment").unique().to_pylist()
    if len(segments) != 1:
        message = f"{path}: expected rows of one segment, found {len(segments)} segments; {AGAIN}"
        raise TableError(message)
    return str(segments[0])
