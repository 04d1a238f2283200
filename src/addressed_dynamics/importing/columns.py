"""Samples from columns: CSV, Parquet, or whatever else has a row per step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import polars
from jaxtyping import Bool, Float64

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.paths import column_and_place
from addressed_dynamics.importing.samples import Samples, usable
from addressed_dynamics.importing.signals import Signal, Signals


def read_table_file(path: Path, kind: str, signals: Signals, agreement: Agreement) -> Samples:
    """Read the table at `path`.

    Rows with a value that is missing or not finite are dropped, and what follows one is another episode.

    Args:
        path: the file.
        kind: `csv` or `parquet`.
        signals: what to read.
        agreement: what the files before this one looked like.

    Raises:
        TableError: the file is damaged, lacks a column or has one of another kind, or the rows of an episode do not
            stand together.
        LogError: it does not agree with the files before it.
    """
    table = _read(path, kind)
    values = column_values(str(path), table, signals.all, agreement)
    label = None if signals.label_column is None else values[:, signals.label_column]
    breaks = np.zeros(len(values), dtype=np.bool_)
    breaks[:1] = True
    if label is not None:
        breaks[1:] = label[1:] != label[:-1]
        _check_together(path, signals, label[breaks])
    return keep_usable(values, breaks, np.zeros(len(values), dtype=np.bool_))


def column_values(
    where: str, table: polars.DataFrame, signals: tuple[Signal, ...], agreement: Agreement
) -> Float64[np.ndarray, "row signal"]:
    """Return the numbers of `signals`, NaN where there is none.

    Raises:
        TableError: there is no such column, or it holds no numbers.
        LogError: the arrays in a column are not as long as those before.
    """
    columns = [_column(where, table, signal, agreement) for signal in signals]
    return np.stack(columns, axis=1) if len(table) else np.zeros((0, len(signals)))


def keep_usable(
    values: Float64[np.ndarray, "row signal"], breaks: Bool[np.ndarray, " row"], terminated: Bool[np.ndarray, " row"]
) -> Samples:
    """Drop the rows with a value that is not finite, and count them.

    Args:
        values: the signals of each row.
        breaks: the row begins an episode.
        terminated: as in `Samples`.
    """
    kept = usable(values)
    breaks = breaks.copy()
    breaks[1:] |= ~kept[:-1]
    counts = {"rows": len(values), "not_finite": int((~kept).sum())}
    return Samples(values[kept], ~breaks[kept], terminated[kept], counts)


def _read(path: Path, kind: str) -> polars.DataFrame:
    try:
        if kind == "csv":
            return polars.read_csv(path, infer_schema_length=None)
        return polars.read_parquet(path)
    # Polars turns a panic of its readers into an exception that is no Exception.
    except (Exception, polars.exceptions.PanicException) as error:
        message = f"{path}: the file cannot be read as {kind} ({reason(error)}); write it again"
        raise TableError(message) from error


def _column(where: str, table: polars.DataFrame, signal: Signal, agreement: Agreement) -> Float64[np.ndarray, " row"]:
    name, place = (signal.field, None) if signal.field in table.columns else column_and_place(signal.field)
    if name not in table.columns:
        message = f"{where}: there is no column '{name}'; its columns are: {', '.join(table.columns)}"
        raise TableError(message)
    column = table[name]
    if place is not None:
        column = _element(where, column, place, agreement)
    if signal.plain and column.dtype.is_numeric():
        return column.cast(polars.Float64).to_numpy()
    return np.array([_number(where, name, row, value, signal) for row, value in enumerate(column)], dtype=np.float64)


def _element(where: str, column: polars.Series, place: int, agreement: Agreement) -> polars.Series:
    if isinstance(column.dtype, polars.Array):
        column = column.arr.to_list()
    if not isinstance(column.dtype, polars.List):
        message = f"{where}: column '{column.name}' has {column.dtype} values, no arrays; leave out the '[{place}]'"
        raise TableError(message)
    for length in column.list.len().drop_nulls().unique().sort():
        agreement.check(f"the length of the arrays in column '{column.name}'", length, where)
        if place >= length:
            message = f"{where}: column '{column.name}' has arrays of {length}, so there is no [{place}]"
            raise TableError(message)
    return column.list.get(place)


def _number(where: str, name: str, row: int, value: Any, signal: Signal) -> float:
    try:
        return signal.number(value)
    except (TypeError, ValueError, OverflowError) as error:
        message = f"{where}: row {row} of column '{name}' cannot be used: {reason(error)}"
        raise TableError(message) from error


def _check_together(path: Path, signals: Signals, labels: Float64[np.ndarray, " stretch"]) -> None:
    found, counts = np.unique(labels[~np.isnan(labels)], return_counts=True)
    apart = int((counts > 1).sum())
    if apart and signals.label is not None:
        message = (
            f"{path}: the rows of {apart} of {len(found)} episodes do not stand together in column "
            f"'{signals.label.field}'; sort the file by it"
        )
        raise TableError(message)
