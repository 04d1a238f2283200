"""Samples from CSV and Parquet files with a row per step."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars
from jaxtyping import Float64

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.params.source import ClockParams, CsvSource, EpisodePerFile, TableSource
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.columns import Table, column_values, find_column, longest_beginning, numbers_in
from addressed_dynamics.importing.csv_text import open_csv
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.rows import Clock, Piece, Rows, check_together, samples_of
from addressed_dynamics.importing.samples import Samples
from addressed_dynamics.importing.seams import FileRows, join_seams
from addressed_dynamics.importing.signals import Signals, plain_signal

_SECONDS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}


def read_tables(
    files: Sequence[Path], source: TableSource, signals: Signals, agreement: Agreement
) -> Iterator[tuple[str, Samples]]:
    """Yield the samples of each file, in the order of their first times, else of their names, `run_10` after `run_9`.

    Rows with a value that is missing or not finite are dropped, and what follows one is another episode. So is what
    follows a step that is not one period, if a clock is named. An episode that goes on in the next file is one.

    Raises:
        TableError: a file is damaged, lacks a column or has one of another kind, the rows of an episode do not stand
            together, or time does not go on inside one.
        LogError: a file does not agree with the files before it.
    """
    clocks = _clocks(source)
    read = (_read(path, source, signals, clocks, agreement) for path in in_order(files, source))
    joined = read if isinstance(source.episode, EpisodePerFile) else join_seams(read, signals, clocks)
    for file in joined:
        yield file.origin, finished(file, signals, clocks)


def finished(file: FileRows, signals: Signals, clocks: tuple[Clock, ...]) -> Samples:
    """Return the samples of a file, with the account of its seams.

    Raises:
        TableError: as in `samples_of`.
    """
    samples = samples_of(file.rows, signals, clocks)
    seams = {name: count + samples.counts.get(name, 0) for name, count in file.counts.items()}
    return replace(samples, counts=samples.counts | seams, details=samples.details | file.details)


def open_parquet(path: Path, fields: Sequence[str]) -> Table:
    """Read those columns of a file that hold `fields`.

    Raises:
        TableError: it is no Parquet file, or damaged.
    """
    try:
        names = list(polars.read_parquet_schema(path))
        wanted = {longest_beginning(field, names) for field in fields}
        frame = polars.read_parquet(path, columns=[name for name in names if name in wanted])
    # Polars turns a panic of its readers into an exception that is no Exception.
    except (Exception, polars.exceptions.PanicException) as error:
        message = f"{path}: the file cannot be read as parquet ({reason(error)}); write it again"
        raise TableError(message) from error
    return Table(
        where=str(path),
        names=tuple(names),
        length=len(frame),
        column=lambda name, _: frame[name],
        row=lambda row: f"row {row} (from 0)",
    )


def natural_order(path: Path) -> list[tuple[int, int, str]]:
    """Return a key by which numbers in names are in the order of numbers."""
    parts = re.split(r"([0-9]+)", path.as_posix())
    return [(0, int(part), part) if part.isdigit() else (1, 0, part) for part in parts if part]


def clock_ticks(table: Table, clocks: tuple[Clock, ...], agreement: Agreement) -> Float64[np.ndarray, "row clock"]:
    """Return what each clock of a table shows, in periods.

    Raises:
        TableError: there is no such column, or it is neither a number nor a time.
    """
    columns = [_shown(table, clock, agreement) / clock.period for clock in clocks]
    return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0))


def _shown(table: Table, clock: Clock, agreement: Agreement) -> Float64[np.ndarray, " row"]:
    signal = plain_signal(clock.column)
    column = find_column(table, signal, agreement)
    if clock.unit_seconds is None:
        return numbers_in(table, column, signal)
    column = _as_dates(column) if column.dtype == polars.String else column
    if isinstance(column.dtype, polars.Datetime):
        return column.dt.timestamp("ns").cast(polars.Float64).to_numpy() * 1e-9 / clock.unit_seconds
    if isinstance(column.dtype, polars.Duration):
        return column.dt.total_nanoseconds().cast(polars.Float64).to_numpy() * 1e-9 / clock.unit_seconds
    return numbers_in(table, column, signal)


def _as_dates(column: polars.Series) -> polars.Series:
    try:
        dates = column.str.to_datetime(time_unit="ns", strict=False)
    except polars.exceptions.PolarsError:  # no form of dates was recognised
        return column
    return dates if dates.null_count() == column.null_count() else column


def _clocks(source: TableSource) -> tuple[Clock, ...]:
    match source.clock:
        case ClockParams(column=str(column), unit=unit, tolerance=tolerance):
            return (Clock(column, tolerance, 1.0 / (source.rate_hz * _SECONDS[unit]), _SECONDS[unit]),)
        case ClockParams(frame=str(frame)):
            return (Clock(frame, 0.0, 1.0, None),)
        case _:
            return ()


def in_order(files: Sequence[Path], source: TableSource) -> list[Path]:
    """Return files in the order of their first times; those that begin at the same time, and all others, by name.

    Raises:
        TableError: there is no such column in a file, or it is neither a number nor a time.
    """
    ordered = sorted(files, key=natural_order)
    times = [clock for clock in _clocks(source) if clock.unit_seconds is not None]
    if not times or len(files) < 2:
        return ordered
    return sorted(ordered, key=lambda path: _first_time(path, source, times[0]))


def _first_time(path: Path, source: TableSource, clock: Clock) -> float:
    table = _open(path, source, [clock.column])
    shown = clock_ticks(table, (clock,), Agreement())[:, 0]
    return float(next(iter(shown[~np.isnan(shown)]), np.inf))


def _open(path: Path, source: TableSource, fields: Sequence[str]) -> Table:
    return open_csv(path, source) if isinstance(source, CsvSource) else open_parquet(path, fields)


def _read(
    path: Path, source: TableSource, signals: Signals, clocks: tuple[Clock, ...], agreement: Agreement
) -> FileRows:
    fields = [signal.field for signal in signals.all] + [clock.column for clock in clocks]
    return FileRows(path.as_posix(), rows_of(_open(path, source, fields), signals, clocks, agreement))


def rows_of(table: Table, signals: Signals, clocks: tuple[Clock, ...], agreement: Agreement) -> Rows:
    """Return the rows of a table.

    Raises:
        TableError: it lacks a column or has one of another kind, or the rows of an episode do not stand together.
        LogError: it does not agree with the tables before it.
    """
    values = column_values(table, signals.all, agreement)
    rows = Rows.of_file(values, clock_ticks(table, clocks, agreement), Piece(table.where, table.row))
    check_together(rows, signals)
    return rows
