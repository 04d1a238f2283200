"""Rows of numbers that wait on disk once they are more than some megabytes."""

from __future__ import annotations

import os
import tempfile
import weakref
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Shaped

from addressed_dynamics.base.errors import LogError

BLOCK_ROWS = 2**14
"""Rows that are worked on at once."""
IN_MEMORY_BYTES = 2**22
"""Bytes of a spool that stay in memory; once it has more, all of them go to disk."""
LARGE_FILES = "/var/tmp"
"""Where temporary files go that may be large, if TMPDIR says nothing else: /tmp is memory on many systems."""

Rows = Shaped[np.ndarray, " row"]
"""Rows of several fields."""


class Spool:
    """A growing list of rows, each of which can be read again and again.

    Its temporary file has no name where the system allows that, and goes when the spool does, or the process, however
    it ends.

    Args:
        row: the fields of a row.
    """

    def __init__(self, row: np.dtype[Any]) -> None:
        self.row = row
        """The fields of a row."""
        self._file = tempfile.SpooledTemporaryFile(IN_MEMORY_BYTES, dir=_folder())  # noqa: SIM115  # closed below
        self._length = 0
        weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        return self._length

    def append(self, rows: Rows) -> None:
        """Add rows at the end.

        Raises:
            LogError: they do not fit on the disk.
        """
        try:
            self._file.seek(self._length * self.row.itemsize)
            self._file.write(rows.tobytes())
        except OSError as error:
            message = (
                f"{_folder()}: what an import sets aside cannot be written there ({error.strerror}); make room, or let "
                "TMPDIR name a folder that has some"
            )
            raise LogError(message) from error
        self._length += len(rows)

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[Rows]:
        """Yield the rows from `start` to `stop` in blocks, which cannot be written to."""
        stop = self._length if stop is None else stop
        for first in range(start, stop, BLOCK_ROWS):
            self._file.seek(first * self.row.itemsize)
            data = self._file.read((min(first + BLOCK_ROWS, stop) - first) * self.row.itemsize)
            yield np.frombuffer(data, self.row)


def _folder() -> str:
    chosen = any(os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP"))
    return LARGE_FILES if not chosen and os.access(LARGE_FILES, os.W_OK) else tempfile.gettempdir()
