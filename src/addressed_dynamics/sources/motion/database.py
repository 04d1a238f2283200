"""Databases of motion, `database.npz`: read block by block, without pickle, and never whole.

A full database has 4.35 million rows and 11 GB. Its arrays lie one after the other in a zip archive, stored or
deflated, so each has a stream of its own, and all of them advance together.
"""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NoReturn

import numpy as np
from jaxtyping import Float32, Int64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import INPUT, OUTPUT, Layout

LAYOUTS: dict[str, Layout | None] = {"Xun": INPUT, "Yun": OUTPUT, "Pun": None}
"""The arrays of a database: inputs, outputs and phase, the last without columns."""
META = "meta"
META_COLUMNS = ("clip", "frame", "cycle", "patch")
"""Columns of the array `meta`, where a database has one."""
CLIPS = "clips"
"""The array of the names of clips that `meta` counts."""
DAMAGE = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    tokenize.TokenError,
    SyntaxError,
    EOFError,
    OSError,
    ValueError,
    RuntimeError,
)
"""What zipfile and NumPy raise at archives and arrays that are damaged, encrypted or compressed in another way."""


@dataclass(frozen=True)
class Block:
    """Consecutive rows of a database; finite, and with phases in [0, 1]."""

    x: Float32[np.ndarray, "row 342"]
    """Inputs, in the order of `layout.INPUT`."""
    y: Float32[np.ndarray, "row 311"]
    """Outputs, in the order of `layout.OUTPUT`."""
    phase: Float32[np.ndarray, " row"]
    """Phase of the gait cycle."""
    meta: Int64[np.ndarray, "row 4"] | None
    """Clip, 60 Hz frame, cycle and terrain patch of each row; None if the database does not say."""

    def last(self) -> Block:
        """Return a copy of the last row, which does not keep the others in memory."""
        meta = None if self.meta is None else self.meta[-1:].copy()
        return Block(self.x[-1:].copy(), self.y[-1:].copy(), self.phase[-1:].copy(), meta)


class _Member:
    """One array of the archive, as a stream of rows."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, name: str, stack: ExitStack) -> None:
        self.path, self.name = path, name
        try:
            entry = archive.getinfo(f"{name}.npy")
        except KeyError:
            found = ", ".join(sorted(each.removesuffix(".npy") for each in archive.namelist())) or "nothing"
            self.fail(f"expected an array of that name, found {found}; save Xun, Yun and Pun with numpy.savez")
        try:
            self._stream: IO[bytes] = stack.enter_context(archive.open(entry))
            self.shape, self.by_columns, self.dtype = _header(self._stream)
            body = entry.file_size - self._stream.tell()
        except DAMAGE as error:
            self.fail(f"expected an array as numpy.savez writes it, but it cannot be read ({_first_line(error)})")
        if self.dtype.hasobject:
            self.fail("holds pickled objects, which are never loaded; save it as an array of float32")
        if self.by_columns and len(self.shape) > 1:
            self.fail("is stored column by column (Fortran order); save numpy.ascontiguousarray of it")
        expected = int(np.prod(self.shape, dtype=np.int64)) * self.dtype.itemsize
        if body != expected:
            self.fail(f"is cut short or damaged: expected {expected:,} bytes of shape {self.shape}, found {body:,}")

    def read(self, rows: int) -> np.ndarray[Any, Any]:
        """Return the next rows."""
        size = rows * self.dtype.itemsize * int(np.prod(self.shape[1:], dtype=np.int64))
        data = bytearray(size)
        view, filled = memoryview(data), 0
        try:
            # The types of the standard library do not say that a member of an archive can read into a buffer.
            while filled < size and (count := self._stream.readinto(view[filled:])):  # type: ignore[attr-defined]
                filled += count
        except DAMAGE as error:
            self.fail(f"is damaged ({_first_line(error)}); download or make it again")
        if filled < size:
            self.fail("is cut short; download or make it again")
        return np.frombuffer(data, self.dtype).reshape(rows, *self.shape[1:])

    def check_end(self) -> None:
        """Let zipfile compare the checksum, which it does at the end of the stream."""
        try:
            self._stream.read(1)
        except DAMAGE as error:
            self.fail(f"is damaged ({_first_line(error)}); download or make it again")

    def fail(self, problem: str) -> NoReturn:
        """Raise a MotionError about this array."""
        message = f"{self.path}: {self.name}: {problem}"
        raise MotionError(message)


class Database:
    """A database that is open, at some row."""

    def __init__(self, path: Path, archive: zipfile.ZipFile, stack: ExitStack) -> None:
        """Open the arrays in `archive` and check their headers."""
        self.path = path
        self._members = {name: _Member(path, archive, name, stack) for name in LAYOUTS}
        phase = self._members["Pun"]
        if len(phase.shape) != 1 or not phase.shape[0]:
            phase.fail(f"expected one phase for each row, found an array of shape {phase.shape}")
        self.rows = phase.shape[0]
        """Number of rows."""
        self.row = 0
        """The row that is read next."""
        for name, layout in LAYOUTS.items():
            _check_floats(self._members[name], (self.rows, layout.width) if layout else (self.rows,))
        self.clips: tuple[str, ...] | None = None
        """Names of the clips; None if the database does not say which rows are of which."""
        if f"{META}.npy" in archive.namelist():
            self._members[META] = _Member(path, archive, META, stack)
            _check_meta(self._members[META], self.rows)
            self.clips = _clip_names(path, archive, stack)

    def read(self, rows: int) -> Block:
        """Return the next rows; all that are left if those are fewer.

        Raises:
            MotionError: the file is damaged, or a value is not finite or out of range.
        """
        rows = min(rows, self.rows - self.row)
        arrays = {name: member.read(rows) for name, member in self._members.items()}
        x, y, phase = (self._floats(name, arrays[name]) for name in LAYOUTS)
        outside = (phase < 0) | (phase > 1)
        if outside.any():
            row = int(outside.argmax())
            self._members["Pun"].fail(f"row {self.row + row}: expected a phase in [0, 1], found {phase[row]:g}")
        meta = self._meta(arrays[META]) if META in arrays else None
        self._advance(rows)
        return Block(x, y, phase, meta)

    def skip(self, rows: int) -> None:
        """Pass over rows, in steps of at most a few megabytes; not by seeking, which would skip the checksum too."""
        while rows:
            step = min(rows, 2**10)
            for member in self._members.values():
                member.read(step)
            self._advance(step)
            rows -= step

    def _advance(self, rows: int) -> None:
        self.row += rows
        if self.row == self.rows:
            for member in self._members.values():
                member.check_end()

    def _floats(self, name: str, values: np.ndarray[Any, Any]) -> Float32[np.ndarray, "row ..."]:
        with np.errstate(over="ignore"):  # a float64 that becomes infinite is found below
            single = values.astype(np.float32, copy=False)
        if not np.isfinite(single).all():
            row, *column = (int(index) for index in np.argwhere(~np.isfinite(single))[0])
            layout = LAYOUTS[name]
            where = f", column {column[0]} ({layout.names[column[0]]})" if layout else ""
            self._members[name].fail(f"row {self.row + row}{where} is not finite; leave its clip out")
        return single

    def _meta(self, values: np.ndarray[Any, Any]) -> Int64[np.ndarray, "row 4"]:
        meta = values.astype(np.int64)
        clips = len(self.clips or ())
        wrong = (meta < 0).any(axis=1) | (meta[:, META_COLUMNS.index("clip")] >= clips)
        if wrong.any():
            row = int(wrong.argmax())
            named = ", ".join(f"{name} {value}" for name, value in zip(META_COLUMNS, meta[row], strict=True))
            self._members[META].fail(
                f"row {self.row + row}: expected numbers from 0, and one of {clips} clips; found {named}"
            )
        return meta


@contextmanager
def open_database(path: Path) -> Iterator[Database]:
    """Open the database `path`, as numpy.savez or numpy.savez_compressed wrote it.

    Raises:
        MotionError: there is no such file, it is no archive of arrays, or an array is missing, damaged, of another
            shape or type, or pickled.
    """
    with ExitStack() as stack:
        try:
            archive = stack.enter_context(zipfile.ZipFile(path))
        except FileNotFoundError as error:
            message = f"{path}: expected a database of motion (.npz), but there is no such file"
            raise MotionError(message) from error
        except DAMAGE as error:
            message = f"{path}: expected an .npz archive, but it is none or cut short ({_first_line(error)})"
            raise MotionError(message) from error
        yield Database(path, archive, stack)


def _header(stream: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    match np.lib.format.read_magic(stream):
        case (1, 0):
            header: tuple[tuple[int, ...], bool, np.dtype[Any]] = np.lib.format.read_array_header_1_0(stream)
        case (2, 0):
            header = np.lib.format.read_array_header_2_0(stream)
        case version:
            message = f"its format has version {version}"
            raise ValueError(message)
    return header


def _check_floats(member: _Member, shape: tuple[int, ...]) -> None:
    if member.dtype.kind != "f" or member.dtype.itemsize < np.dtype(np.float32).itemsize:
        member.fail(f"expected float32, found {member.dtype}")
    if member.shape != shape:
        hint = "the layout has no other width" if member.shape[1:] != shape[1:] else "all arrays need as many rows"
        member.fail(f"expected shape {shape}, found {member.shape}; {hint}")


def _check_meta(member: _Member, rows: int) -> None:
    if member.dtype.kind not in "iu":
        member.fail(f"expected integers, found {member.dtype}")
    if member.shape != (rows, len(META_COLUMNS)):
        expected = (rows, len(META_COLUMNS))
        member.fail(f"expected shape {expected} ({', '.join(META_COLUMNS)}), found {member.shape}")


def _clip_names(path: Path, archive: zipfile.ZipFile, stack: ExitStack) -> tuple[str, ...]:
    member = _Member(path, archive, CLIPS, stack)
    if member.dtype.kind != "U" or len(member.shape) != 1:
        member.fail(f"expected a list of names, found {member.dtype} of shape {member.shape}")
    names = tuple(str(name) for name in member.read(member.shape[0]))
    if len(set(names)) != len(names):
        member.fail("a name occurs twice; give every clip its own")
    member.check_end()
    return names


def _first_line(error: BaseException) -> str:
    return str(error).split("\n", maxsplit=1)[0] or type(error).__name__
