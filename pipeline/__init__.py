"""One thin script per stage: read, call, write."""

import os
import sys
from importlib.metadata import version
from pathlib import Path

from addressed_dynamics.base.interrupts import say_nothing_of_interrupts


def _check_version(file: Path) -> None:
    """End in a project of one's own whose stages, and all that they made, are of another version than the installed."""
    made, there = file.read_text(encoding="utf-8").strip(), version("addressed-dynamics")
    if made != there:
        sys.exit(
            f"error: {file}: the stages are of addressed-dynamics {made}, and {there} is installed; install {made}, or "
            "let 'addressed-dynamics init . --renew' write those of this one, with which all is made anew"
        )


# Both are read when PyTorch and NumPy are imported. Threads that wait for each other must not keep a core busy that
# another stage could use; and NumPy's sums must not depend on how many cores there are.
os.environ |= {"OMP_WAIT_POLICY": "PASSIVE", "OPENBLAS_NUM_THREADS": "1"}
# `run_stage` speaks for a stage, but only once the stage's imports are done, which may take seconds.
say_nothing_of_interrupts()
if (_VERSION := Path(__file__).with_name("version.txt")).is_file():
    _check_version(_VERSION)
