"""Files of the earlier stages, read and checked."""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TypeVar
from zipfile import BadZipFile

import numpy as np
from pydantic import TypeAdapter, ValidationError

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.reporting.common.missing import remedy_of

Value = TypeVar("Value")


Columns = dict[str, np.ndarray]
"""Columns of a CSV file; NaN where a row has no number."""


def read_json(path: Path, kind: type[Value]) -> Value:
    """Read a JSON file of a kind.

    Raises:
        ReportError: it is missing or malformed.
    """
    try:
        return TypeAdapter(kind).validate_json(_read_text(path))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(part) for part in first["loc"]) or "the file"
        message = f"{path}: {place}: {first['msg']}; '{remedy_of(path)}' writes it anew"
        raise ReportError(message) from error


def read_csv(path: Path, *, by: str, needed: tuple[str, ...]) -> dict[str, Columns]:
    """Read the columns of a CSV file, apart for each value of the column `by`.

    Raises:
        ReportError: it is missing, one of the columns `needed` is, or a cell is not a number.
    """
    return columns_of(path, read_rows(path, (by, *needed)), by)


def read_csv_if_there(path: Path, *, by: str, needed: tuple[str, ...]) -> dict[str, Columns]:
    """Read the columns of a CSV file as `read_csv` does; nothing if there is none.

    Raises:
        ReportError: one of the columns `needed` is missing, or a cell is not a number.
    """
    return read_csv(path, by=by, needed=needed) if path.is_file() else {}


def read_rows(path: Path, needed: tuple[str, ...]) -> list[dict[str, str]]:
    """Read the rows of a CSV file.

    Raises:
        ReportError: it is missing, or one of the columns `needed` is.
    """
    rows = list(csv.DictReader(_read_text(path).splitlines()))
    for name in needed:
        if rows and name not in rows[0]:
            message = f"{path}: there is no column '{name}'; '{remedy_of(path)}' writes it anew"
            raise ReportError(message)
    return rows


def columns_of(path: Path, rows: list[dict[str, str]], by: str) -> dict[str, Columns]:
    """Return the columns of rows of the file at `path`, apart for each value of the column `by`.

    Raises:
        ReportError: a cell is not a number.
    """
    groups: dict[str, list[dict[str, str]]] = {}
    for row in rows:
        groups.setdefault(row[by], []).append(row)
    try:
        return {
            key: {name: np.array([float(row[name] or "nan") for row in group]) for name in group[0] if name != by}
            for key, group in groups.items()
        }
    except (ValueError, TypeError) as error:
        message = f"{path}: a cell is not a number ({error}); '{remedy_of(path)}' writes it anew"
        raise ReportError(message) from error


def read_arrays(path: Path, make: Callable[[Mapping[str, np.ndarray]], Value]) -> Value:
    """Make something of the arrays that an evaluation wrote.

    Args:
        path: the file.
        make: what becomes of its arrays, by their names; a `KeyError` says that one is missing.

    Raises:
        ReportError: it is missing or malformed, or lacks an array.
    """
    try:
        with np.load(path, allow_pickle=False) as file:
            return make(file)
    except FileNotFoundError as error:
        raise _missing_file(path) from error
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
        message = (
            f"{path}: not the arrays that the evaluate stage writes ({error}); '{remedy_of(path)}' writes them anew"
        )
        raise ReportError(message) from error


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        raise _missing_file(path) from error
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: cannot be read ({error}); '{remedy_of(path)}' writes it anew"
        raise ReportError(message) from error


def _missing_file(path: Path) -> ReportError:
    """Return the error that says so of `path`."""
    return ReportError(f"{path}: missing, so there is nothing to report; '{remedy_of(path)}' makes it")
