"""CSV files as text: what stands in a cell is kept until it is known what is wanted of it."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import polars

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.params.source import CsvSource
from addressed_dynamics.importing.columns import Table
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.signals import EXACT, Signal

_TRUTH = {"true": True, "false": False}
_REPEATED = "_duplicated_"
"""Polars puts this between a name that stands twice and a number."""


def open_csv(path: Path, source: CsvSource) -> Table:
    """Read the file at `path`, all cells as text.

    Blanks around a cell, and quotes around what is left, do not count.

    Raises:
        TableError: it is no CSV file, it is not in UTF-8, or two columns have the same name.
    """
    frame = _without_empty_lines(path, source, _read(path, source))
    names = [_bare(name) for name in frame.columns]
    if broken := next((name for name in names if "\ufffd" in name), None):
        message = f"{path}: the file cannot be read as csv (the name '{broken}' is not in UTF-8); save it in UTF-8"
        raise TableError(message)
    for raw, name in zip(frame.columns, names, strict=True):
        original = raw.rpartition(_REPEATED)[0]
        if names.count(name) > 1 or (original and original in frame.columns):
            message = f"{path}: two columns have the name {_bare(original) or name!r}; rename one in the first line"
            raise TableError(message)
    raw_names = dict(zip(names, frame.columns, strict=True))
    return Table(
        where=str(path),
        names=tuple(names),
        length=len(frame),
        column=lambda name, signal: _typed(_cells(frame[raw_names[name]], source, signal), source, signal),
        values=lambda cells, signal: _values(cells, source, signal),
        row=lambda row: f"line {_line(path, source, row)}",
        advice=_separator_advice(names, source),
    )


def _read(path: Path, source: CsvSource) -> polars.DataFrame:
    try:
        return polars.read_csv(
            path,
            infer_schema=False,
            separator=source.separator,
            comment_prefix=source.comment,
            skip_lines=_lines_before_the_names(path, source),
        )
    # Polars turns a panic of its readers into an exception that is no Exception.
    except (Exception, polars.exceptions.PanicException) as error:
        message = f"{path}: the file cannot be read as csv ({_what_is_wrong(path, source, error)}); write it again"
        raise TableError(message) from error


def _without_empty_lines(path: Path, source: CsvSource, frame: polars.DataFrame) -> polars.DataFrame:
    """Take out what is no row; in a single column an empty line is a missing value."""
    if frame.width == 1 or not frame.select(polars.all_horizontal(polars.all().is_null()).any()).item():
        return frame
    rows = polars.Series([bool(cells) for _, cells in _records(path, source)][1:], dtype=polars.Boolean)
    return frame.filter(rows) if len(rows) == len(frame) else frame


def _cells(cells: polars.Series, source: CsvSource, signal: Signal) -> polars.Series:
    """Return the bare texts; null where there is no value."""
    cells = cells.str.strip_chars()
    if cells.str.starts_with('"').any():
        cells = cells.str.replace(r'(?s)^"(.*)"$', "${1}").str.strip_chars()
    marks = sorted({"", *source.missing} - set(signal.names))
    return cells.to_frame("cell").select(polars.when(~polars.col("cell").is_in(marks)).then("cell")).to_series()


def _typed(cells: polars.Series, source: CsvSource, signal: Signal) -> polars.Series:
    """Return numbers if all cells are numbers and the signal takes numbers, else the texts."""
    if signal.names:
        return cells
    floats = _floats(cells, source)
    # Labels that differ in their last digit, and values that are to be refused for it.
    whole = signal.takes_text or (floats.abs() >= EXACT).any()
    for typed in (*([cells.cast(polars.Int128, strict=False)] if whole else []), floats):
        if typed.null_count() == cells.null_count():
            return typed
    return cells


def _values(cells: polars.Series, source: CsvSource, signal: Signal) -> list[Any]:
    """Return what each of some cells stands for: a number, true, false, a text, or None for nothing."""
    if cells.dtype != polars.String:
        return cells.to_list()
    return [
        text if text is None or text in signal.names or signal.takes_text else _value(text, number)
        for text, number in zip(cells, _floats(cells, source), strict=True)
    ]


def _value(text: str, number: float | None) -> Any:
    return _TRUTH.get(text.lower(), text) if number is None else number


def _floats(cells: polars.Series, source: CsvSource) -> polars.Series:
    if source.decimal != ".":
        # A point would be between thousands, where it says nothing, or the sign that was not expected.
        cells = cells.str.replace_all(".", "?", literal=True).str.replace(source.decimal, ".", literal=True)
    return cells.cast(polars.Float64, strict=False)


def _bare(text: str) -> str:
    text = text.strip()
    return text[1:-1].strip() if len(text) > 1 and text[0] == text[-1] == '"' else text


def _separator_advice(names: list[str], source: CsvSource) -> str:
    others = [sign for sign in (",", ";", "\t", "|") if sign != source.separator and sign in names[0]]
    if len(names) > 1 or not others:
        return ""
    return f"; if a cell ends at {others[0]!r}, give the source separator: {others[0]!r}"


def _lines_before_the_names(path: Path, source: CsvSource) -> int:
    """Return how many empty lines and comments the file begins with."""
    count = 0
    with path.open("rb") as file:
        for line in file:
            text = line.strip()
            if text and not (source.comment and line.startswith(source.comment.encode())):
                break
            count += 1
    return count


def _records(path: Path, source: CsvSource) -> Iterator[tuple[int, list[str]]]:
    """Yield the line in which each record of the file begins, from 1, and its cells; the first has the names."""
    line = 0

    def lines() -> Iterator[str]:
        nonlocal line
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            for number, text in enumerate(file, start=1):
                if source.comment is None or not text.startswith(source.comment):
                    line = number
                    yield text

    begun = False
    for cells in csv.reader(lines(), delimiter=source.separator):
        begun = begun or bool(cells)
        if begun:
            # A record of several lines is said to be in the last of them.
            yield line, cells


def _line(path: Path, source: CsvSource, row: int) -> int:
    records = _records(path, source)
    _, names = next(records, (0, []))
    rows = (line for line, cells in records if cells or len(names) == 1)
    return next(islice(rows, row, None), 0)


def _what_is_wrong(path: Path, source: CsvSource, error: BaseException) -> str:
    what = reason(error)
    if "utf-8" in what:
        return f"{what}; save it in UTF-8"
    if "more fields" in what:
        records = _records(path, source)
        _, names = next(records, (0, []))
        for line, cells in records:
            if len(cells) > len(names):
                return f"line {line} has {len(cells)} cells, but there are {len(names)} names"
    return what
