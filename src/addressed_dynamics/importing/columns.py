"""From the columns of a table to numbers: parts of structures and arrays by their path, every refusal with its row."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars
from jaxtyping import Float64

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.paths import MOST_LISTED
from addressed_dynamics.importing.signals import EXACT, Signal, too_long

_PLACE = re.compile(r"\[(\d+)\]")


def typed_values(cells: polars.Series, signal: Signal) -> list[Any]:
    """Return the values of cells that have a type; the signal does not matter."""
    del signal
    return cells.to_list()


@dataclass(frozen=True)
class Table:
    """Columns by their names; nobody looks at those that are not asked for."""

    where: str
    """The file, for errors."""
    names: tuple[str, ...]
    """Names of the columns."""
    length: int
    """Number of rows."""
    column: Callable[[str, Signal], polars.Series]
    """Returns the column of a name, for a signal."""
    row: Callable[[int], str]
    """Says which row is at a place, from 0, as its owner would find it: `line 12`."""
    values: Callable[[polars.Series, Signal], list[Any]] = typed_values
    """Returns what cells stand for."""
    advice: str = ""
    """What to try if a column is missing."""


def column_values(table: Table, signals: Sequence[Signal], agreement: Agreement) -> Float64[np.ndarray, "row signal"]:
    """Return the numbers of `signals`, NaN where there is none.

    Raises:
        TableError: there is no such column, or it holds no numbers, or whole numbers that float64 cannot hold.
        LogError: the arrays in a column are not as long as those before.
    """
    columns = [numbers_in(table, _exact(table, signal, agreement), signal) for signal in signals]
    return np.stack(columns, axis=1) if columns else np.zeros((table.length, 0))


def _exact(table: Table, signal: Signal, agreement: Agreement) -> polars.Series:
    column = find_column(table, signal, agreement)
    if signal.plain and column.dtype.is_integer():
        far = column.cast(polars.Float64).abs() >= EXACT
        if far.any():
            row = int(far.arg_true()[0])
            message = f"{table.where}: {table.row(row)}, column '{signal.field}': {too_long(column[row])}"
            raise TableError(message)
    return column


def find_column(table: Table, signal: Signal, agreement: Agreement) -> polars.Series:
    """Return the column that the field of a signal names, or the part of one: `a`, `a.x`, `a[0][1]`, `a.x[2]`.

    A column whose own name looks like a path wins; an array of one element is that element.

    Raises:
        TableError: there is no such column or part.
        LogError: the arrays in a column are not as long as those before.
    """
    name = longest_beginning(signal.field, table.names)
    if name is None:
        # A damaged header may have anything in its names.
        listed = ", ".join(name if name.isprintable() else repr(name) for name in table.names[:MOST_LISTED]) or "none"
        more = f" and {len(table.names) - MOST_LISTED} more" if len(table.names) > MOST_LISTED else ""
        message = f"{table.where}: there is no column '{signal.field}'; its columns are: {listed}{more}{table.advice}"
        raise TableError(message)
    return _part(table, table.column(name, signal), name, signal.field, agreement)


def longest_beginning(field: str, names: Sequence[str]) -> str | None:
    """Return the longest of `names` that `field` is or begins with, before a dot or a bracket."""
    fitting = [name for name in names if field.startswith(name) and field[len(name) :][:1] in ("", ".", "[")]
    return max(fitting, key=len, default=None)


def _part(table: Table, column: polars.Series, done: str, field: str, agreement: Agreement) -> polars.Series:
    """Return what `field` names in `column`, which is what its beginning `done` names."""
    rest = field[len(done) :]
    place = _PLACE.match(rest)
    if isinstance(column.dtype, polars.Struct):
        name = longest_beginning(rest[1:], column.struct.fields) if rest.startswith(".") else None
        if name is not None:
            return _part(table, column.struct.field(name), f"{done}.{name}", field, agreement)
    elif column.dtype.is_nested():
        if place is not None:
            element = _element(table, column, done, int(place[1]), agreement)
            return _part(table, element, done + place[0], field, agreement)
        if not rest and _longest(column) == 1:
            return _part(table, _element(table, column, done, 0, agreement), field, field, agreement)
    elif not rest:
        return column
    raise TableError(_no_number(table, column, done, field))


def _no_number(table: Table, column: polars.Series, done: str, field: str) -> str:
    parts = ", ".join(_forms(done, column))
    match column.dtype:
        case polars.Struct():
            what, advice = "parts of its own", f"name one of them: {parts}"
        case polars.List() | polars.Array():
            what, advice = f"arrays of {_longest(column)}", f"name one of their elements: {parts}"
        case dtype:
            what, advice = f"{dtype} values, no arrays or parts", f"leave out the '{field[len(done) :]}'"
    return f"{table.where}: column '{done}' has {what}, so '{field}' cannot be used; {advice}"


def _element(table: Table, column: polars.Series, name: str, place: int, agreement: Agreement) -> polars.Series:
    column = _lists(column)
    # An array without elements is a missing value.
    for length in column.list.len().drop_nulls().unique().sort():
        if not length:
            continue
        agreement.check(f"the length of the arrays in column '{name}'", length, table.where)
        if place >= length:
            message = f"{table.where}: column '{name}' has arrays of {length}, so there is no [{place}]"
            raise TableError(message)
    return column.list.get(place, null_on_oob=True)


def numbers_in(table: Table, column: polars.Series, signal: Signal) -> Float64[np.ndarray, " row"]:
    """Return the numbers that `signal` makes of the cells of a column.

    Raises:
        TableError: a cell holds something else.
    """
    if signal.plain and (column.dtype.is_numeric() or column.dtype == polars.Boolean):
        return column.cast(polars.Float64).to_numpy()
    cells = column.unique(maintain_order=True)
    numbers = []
    for place, value in enumerate(table.values(cells, signal)):
        try:
            numbers.append(signal.number(value))
        except (TypeError, ValueError, OverflowError) as error:
            row = int(column.eq_missing(cells[place : place + 1]).arg_true()[0])
            message = (
                f"{table.where}: {table.row(row)}, column '{signal.field}': {_refusal(cells[place], signal, error)}"
            )
            raise TableError(message) from error
    return column.replace_strict(cells, numbers, return_dtype=polars.Float64).to_numpy()


def _refusal(cell: Any, signal: Signal, error: Exception) -> str:
    if cell == signal.field:
        return f"'{cell}' is the column's own name; take such lines out, or make a file of what follows each"
    return f"{reason(error)}; correct it, or name another column"


def _longest(column: polars.Series) -> int:
    return max(_lists(column).list.len().drop_nulls().unique().to_list(), default=0)


def _lists(column: polars.Series) -> polars.Series:
    return column.arr.to_list() if isinstance(column.dtype, polars.Array) else column


def _forms(name: str, column: polars.Series) -> Iterator[str]:
    """Yield how the parts of a column can be named."""
    match column.dtype:
        case polars.Struct():
            for field in column.struct.fields:
                yield from _forms(f"{name}.{field}", column.struct.field(field))
        case polars.List() | polars.Array():
            length = _longest(column)
            inner = _lists(column).list.get(0, null_on_oob=True)
            if isinstance(inner.dtype, polars.List | polars.Array | polars.Struct):
                yield from _forms(f"{name}[0]", inner)
            else:
                yield f"{name}[0:{length}]"
        case _:
            yield name
