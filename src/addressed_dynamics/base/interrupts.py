"""Ctrl-C while modules are imported, when nobody can catch it yet."""

import sys
from types import TracebackType


def say_nothing_of_interrupts() -> None:
    """Let Ctrl-C end this process without a traceback, where nothing catches it."""
    sys.excepthook = _say


def _say(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, traceback)
