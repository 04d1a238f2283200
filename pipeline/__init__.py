"""One thin script per stage: read, call, write."""

import sys
from types import TracebackType


def _say_nothing_of_ctrl_c(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, traceback)


# `run_stage` speaks for a stage, but only once the stage's imports are done, which may take seconds.
sys.excepthook = _say_nothing_of_ctrl_c
