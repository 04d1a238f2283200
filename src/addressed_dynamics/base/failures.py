"""Exceptions on their way from a process that works to the one that asked for the work."""

from __future__ import annotations

import pickle
import traceback
from dataclasses import dataclass


class WorkerTraceback(Exception):
    """The traceback of an exception in a worker process, as text: the cause that the parent shows for it."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


@dataclass(frozen=True)
class Failure:
    """An exception on its way from a worker process to its parent. Always picklable, whatever the exception is."""

    summary: str
    """Its type and message, and the line that raised it."""
    traceback: str
    """The traceback in the worker process."""
    pickled: bytes | None
    """The exception itself; None if it does not survive pickling."""

    @staticmethod
    def of(error: Exception) -> Failure:
        """Describe `error`, which has been caught."""
        frames = traceback.extract_tb(error.__traceback__)
        where = f" ({frames[-1].filename}, line {frames[-1].lineno}, in {frames[-1].name})" if frames else ""
        text = "".join(traceback.format_exception(error))
        return Failure(f"{type(error).__qualname__}: {error}{where}", text, _pickled(error))

    def exception(self) -> Exception:
        """Return the exception to raise in the parent, with the worker's traceback as its cause.

        One that does not survive pickling becomes a RuntimeError with its type, its message and where it was raised.
        """
        error: Exception = RuntimeError(self.summary) if self.pickled is None else pickle.loads(self.pickled)
        error.__cause__ = WorkerTraceback(self.traceback)
        return error


def _pickled(error: Exception) -> bytes | None:
    try:
        pickled = pickle.dumps(error)
        again = pickle.loads(pickled)
    except Exception:
        return None
    return pickled if type(again) is type(error) and str(again) == str(error) else None
