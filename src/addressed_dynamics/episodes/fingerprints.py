"""Rows that are equal, found by 64 bits of each: in memory, or in files where they are too many."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Shaped, UInt64

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.files import atomic_path

Fingerprints = UInt64[np.ndarray, " row"]
"""64 bits of each row; see `row_fingerprints`."""
BUCKET_ROWS = 2**18
"""Rows that are looked through at once, on average."""
MOST_BUCKETS = 2**12
"""The most files; beyond a thousand million rows, each has more rows than `BUCKET_ROWS`."""
WAITING_ROWS = 2**20
"""Rows that are kept until all files get their part of them: few writes of much."""
_BITS = 64
_RECORD = np.dtype([("fingerprint", "<u8"), ("row", "<u8")])


@dataclass(frozen=True)
class Duplicates:
    """How many rows are equal to another row before them."""

    count: int
    """How many."""
    of: int
    """Among how many."""
    first: int | None
    """The first of them, counted from 0; None if there is none."""

    def merge(self, other: Duplicates) -> Duplicates:
        """Add those of other rows, none of which is equal to one of these."""
        found = [each for each in (self.first, other.first) if each is not None]
        return Duplicates(self.count + other.count, self.of + other.of, min(found, default=None))


def row_fingerprints(*columns: Shaped[np.ndarray, "row ..."]) -> UInt64[np.ndarray, " row"]:
    """Return 64 bits for each row that are equal for equal rows, and differ for different ones but for rare chance.

    Among a million rows that chance is 3e-8, among a thousand million 0.03. 0 and -0 count as equal.
    """
    fingerprint = np.zeros(len(columns[0]), dtype=np.uint64)
    for column in columns:
        for values in column.reshape(len(column), -1).T:
            # Adding 0.0 turns -0.0 into 0.0.
            bits = (values.astype(np.float64) + 0.0).view(np.uint64)
            fingerprint = _mixed(fingerprint ^ bits)
    return fingerprint


def find_duplicates(fingerprints: Fingerprints, rows: UInt64[np.ndarray, " row"] | None = None) -> Duplicates:
    """Count the rows that are equal to another row before them.

    Args:
        fingerprints: one for each row, in the order of the rows.
        rows: which rows these are, increasing; None for those from 0.
    """
    order = np.argsort(fingerprints, kind="stable")  # of equal rows, the first comes first
    again = order[1:][np.diff(fingerprints[order]) == 0]
    first = int(again.min()) if len(again) else None
    if first is not None and rows is not None:
        first = int(rows[first])
    return Duplicates(len(again), len(fingerprints), first)


@contextmanager
def fingerprint_writer(path: Path) -> Iterator[Callable[[Fingerprints], None]]:
    """Yield a function that adds fingerprints of the next rows to a file, which appears when the block ends well.

    The function raises a TableError if they cannot be written. It has to be called, if only without rows.
    """
    with atomic_path(path) as temporary:
        yield lambda fingerprints: _append(temporary, fingerprints.astype("<u8"))


class Buckets:
    """The fingerprints of any number of rows, in files by their highest bits, so that equal ones are in the same file.

    A file at a time is then looked through. What is found is what `find_duplicates` finds in all of them at once; the
    files have 16 bytes for each row.

    Args:
        folder: where the files go; it is made, and whoever wants them gone removes it.
        rows: how many rows there will be, for a good number of files.
    """

    def __init__(self, folder: Path, rows: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._bits = min(max(rows // BUCKET_ROWS, 2), MOST_BUCKETS).bit_length() - 1
        self._waiting = list[Fingerprints]()
        self._added = self._written = 0

    def add(self, fingerprints: Fingerprints) -> None:
        """Add those of the next rows.

        Raises:
            TableError: they cannot be written.
        """
        self._waiting.append(fingerprints)
        self._added += len(fingerprints)
        if self._added - self._written >= WAITING_ROWS:
            self._write()

    def add_file(self, path: Path) -> None:
        """Add those of the next rows, which `fingerprint_writer` wrote, and remove their file.

        Raises:
            TableError: as in `add`.
        """
        with path.open("rb") as file:
            while block := file.read(WAITING_ROWS * 8):
                self.add(np.frombuffer(block, "<u8"))
        path.unlink()

    def find(self) -> Duplicates:
        """Return the duplicates among all rows.

        Raises:
            TableError: as in `add`.
        """
        self._write()
        found = Duplicates(0, 0, None)
        for path in self._paths():
            if path.exists():
                records = np.fromfile(path, _RECORD)
                found = found.merge(find_duplicates(records["fingerprint"].copy(), records["row"].copy()))
        assert found.of == self._added, "a file of fingerprints was changed by somebody else"
        return found

    def _paths(self) -> list[Path]:
        return [self._folder / f"{bucket:04x}" for bucket in range(2**self._bits)]

    def _write(self) -> None:
        records = np.empty(self._added - self._written, _RECORD)
        records["fingerprint"] = np.concatenate([*self._waiting, np.empty(0, np.uint64)])
        records["row"] = np.arange(self._written, self._added)
        buckets = (records["fingerprint"] >> np.uint64(_BITS - self._bits)).astype(np.uint16)
        records = records[np.argsort(buckets, kind="stable")]
        stops = np.cumsum(np.bincount(buckets, minlength=2**self._bits)).tolist()
        for path, start, stop in zip(self._paths(), [0, *stops], stops, strict=False):
            if stop > start:
                _append(path, records[start:stop])
        self._waiting.clear()
        self._written = self._added


def _append(path: Path, values: Shaped[np.ndarray, " row"]) -> None:
    try:
        with path.open("ab") as file:
            file.write(values.tobytes())
    except OSError as error:
        message = (
            f"{path.parent}: what finds equal rows, at most 24 bytes for each, cannot be set aside there "
            f"({error.strerror}); make room, and run the stage again"
        )
        raise TableError(message) from error


def _mixed(values: UInt64[np.ndarray, " row"]) -> UInt64[np.ndarray, " row"]:
    # The finaliser of SplitMix64 (Steele, Lea and Flood, 2014): every input bit reaches every output bit.
    values = values + np.uint64(0x9E3779B97F4A7C15)  # wraps around, as it should
    values = (values ^ (values >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    values = (values ^ (values >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: UInt64[np.ndarray, " row"] = values ^ (values >> np.uint64(31))
    return mixed
