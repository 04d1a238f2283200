"""What all stages share: where data lies, how a stage is called, and how it ends when something is wrong."""

import argparse
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import NoReturn

from tqdm import tqdm

from addressed_dynamics.base.errors import AddressedDynamicsError

DATA = Path("data")
"""Everything DVC owns; relative, because DVC runs stages in the root of the repository."""


def raw_dir(experiment: str) -> Path:
    """Return the folder of an experiment's MCAP logs."""
    return DATA / "raw" / experiment


def tables_dir(experiment: str) -> Path:
    """Return the folder of an experiment's Parquet tables."""
    return DATA / "tables" / experiment


def models_dir(experiment: str) -> Path:
    """Return the folder of an experiment's models."""
    return DATA / "models" / experiment


def reports_dir(experiment: str) -> Path:
    """Return the folder of an experiment's metrics, curves and report."""
    return DATA / "reports" / experiment


def evaluation_dir(experiment: str) -> Path:
    """Return the folder of the arrays that an experiment's figures are made of."""
    return DATA / "evaluation" / experiment


def checkpoints_dir(experiment: str) -> Path:
    """Return the folder of an experiment's checkpoints: outside `data`, because DVC removes outputs before a stage."""
    return Path(".checkpoints") / experiment


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def progress(description: str, unit: str, total: int | None = None) -> "tqdm[NoReturn]":
    """Return a progress bar with rate and remaining time; where nobody watches it, it writes a line now and then."""
    interval = 0.2 if sys.stderr.isatty() else 15.0
    return tqdm(
        desc=description, unit=unit, total=total, unit_scale=True, mininterval=interval, maxinterval=2 * interval
    )


def say(line: str) -> None:
    """Tell whoever watches a stage, or reads its log later."""
    print(line, file=sys.stderr)


class _Terminated(BaseException):
    """SIGTERM, as an exception that cleans up on its way, like Ctrl-C."""


def run_stage(main: Callable[[str, Path], None]) -> NoReturn:
    """Call `main(experiment, params_file)` with the options of the command line, then exit.

    The status is 0 if all went well, 1 after a project error or an error of the system (a full disk), 130 after Ctrl-C
    and 143 after SIGTERM; then stderr ends in one line that says what happened. Any other exception is a bug and shows
    its traceback.
    """
    options = _parser(main.__module__).parse_args()
    _end_well(lambda: main(options.experiment, options.params))


def run_import(main: Callable[[str, Path, Path], None]) -> NoReturn:
    """Call `main(experiment, params_file, source)` likewise: for stages that read what is not the pipeline's own."""
    parser = _parser(main.__module__)
    parser.add_argument("--source", required=True, type=Path, help="file or folder to import")
    options = parser.parse_args()
    _end_well(lambda: main(options.experiment, options.params, options.source))


def _parser(module: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=sys.modules[module].__doc__)
    parser.add_argument("--experiment", required=True, help="section of the params file, for instance mountaincar")
    parser.add_argument("--params", required=True, type=Path, help="params file, for instance params.yaml")
    return parser


def _end_well(stage: Callable[[], None]) -> NoReturn:
    signal.signal(signal.SIGTERM, _raise_terminated)
    try:
        stage()
    except (AddressedDynamicsError, OSError) as error:
        _end(f"error: {error}", error, status=1)
    except KeyboardInterrupt as interrupt:
        _end("interrupted", interrupt, status=128 + signal.SIGINT)
    except _Terminated as termination:
        _end("terminated", termination, status=128 + signal.SIGTERM)
    sys.exit(0)


def _raise_terminated(_number: int, _frame: FrameType | None) -> NoReturn:
    raise _Terminated


def _end(message: str, error: BaseException, *, status: int) -> NoReturn:
    line = "; ".join([message, *getattr(error, "__notes__", [])])
    print(line, file=sys.stderr)
    sys.exit(status)
