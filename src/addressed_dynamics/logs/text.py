"""Text files of numbers, read in bulk; whoever damaged one is told the line."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import MotionError


def read_lines(path: Path) -> list[str]:
    """Return the lines of a text file.

    Raises:
        MotionError: it cannot be read.
    """
    try:
        return path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        message = f"{path}: cannot be read ({error.strerror})"
        raise MotionError(message) from error


def parse_table(path: Path, lines: list[str], columns: int, after: int = 0) -> Float64[np.ndarray, "row column"]:
    """Return the numbers of all lines that are not blank.

    Args:
        path: the file, for errors.
        lines: all of its lines.
        columns: how many numbers a line should have.
        after: lines at the beginning that are something else.

    Raises:
        MotionError: a line has another number of values, or a value is not a finite number.
    """
    if not any(line.strip() for line in lines[after:]):
        return np.empty((0, columns))
    try:
        values = np.loadtxt(lines[after:], comments=None, ndmin=2)
    except ValueError:  # its own message counts rows instead of lines, and does not know the file
        _fail(path, lines, columns, after)
    if values.shape[1] != columns or not np.isfinite(values).all():
        _fail(path, lines, columns, after)
    return values


def _fail(path: Path, lines: list[str], columns: int, after: int) -> NoReturn:
    """Find the first line that is wrong, and say so."""
    for number, line in enumerate(lines[after:], after + 1):
        words = line.split()
        if words and len(words) != columns:
            message = f"{path}, line {number}: expected {columns} numbers, but found {len(words)}"
            raise MotionError(message)
        wrong = next((word for word in words if not _is_finite(word)), None)
        if wrong is not None:
            message = f"{path}, line {number}: expected a finite number, but found '{wrong[:40]}'"
            raise MotionError(message)
    message = f"{path}: expected lines of {columns} numbers, but found something else"
    raise MotionError(message)


def _is_finite(word: str) -> bool:
    try:
        return bool(np.isfinite(float(word)))
    except ValueError:
        return False
