"""What all stages share: where data lies, how a stage is called, and how it ends when something is wrong."""

import argparse
import os
import signal
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from types import FrameType
from typing import Any, NoReturn

from tqdm import tqdm

from addressed_dynamics.base.cluster import ENGINE, engine
from addressed_dynamics.base.errors import AddressedDynamicsError, ParamsError
from addressed_dynamics.base.params.experiments import replaced_keys

DATA = Path("data")
"""Everything DVC owns; relative, because DVC runs stages in the root of the repository."""
REPLACED_SHOWN = 8
"""So many keys are named that another params file takes the place of."""
PROCESSES = "ADDRESSED_DYNAMICS_PROCESSES"
"""Environment variable with the number of trainings at the same time."""
WORKERS = "ADDRESSED_DYNAMICS_WORKERS"
"""Environment variable with the number of workers of a cluster that train one ensemble together."""


def raw_dir(experiment: str) -> Path:
    """Return the folder of an experiment's MCAP logs."""
    return DATA / "raw" / experiment


def tables_dir(experiment: str) -> Path:
    """Return the folder of an experiment's Parquet tables."""
    return DATA / "tables" / experiment


def models_dir(experiment: str) -> Path:
    """Return the folder of an experiment's models."""
    return DATA / "models" / experiment


def policies_dir(experiment: str) -> Path:
    """Return the folder of an experiment's policy."""
    return DATA / "policies" / experiment


def figures_dir(experiment: str, stage: str = "") -> Path:
    """Return the folder of what a stage found: figures as JSON, curves as CSV."""
    return DATA / "figures" / experiment / stage


def evaluation_dir(experiment: str) -> Path:
    """Return the folder of what the evaluation of an experiment found."""
    return DATA / "evaluation" / experiment


def reports_dir(experiment: str) -> Path:
    """Return the folder of an experiment's report."""
    return DATA / "reports" / experiment


def checkpoints_dir(experiment: str) -> Path:
    """Return the folder of an experiment's checkpoints: outside `data`, because DVC removes outputs before a stage."""
    return Path(".checkpoints") / experiment


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def training_processes(*, gpu: bool = False) -> int:
    """Return how many trainings run at the same time, each in a process with one thread.

    As many as there are cores, or one on a GPU, which several would share; or as the environment variable
    `ADDRESSED_DYNAMICS_PROCESSES` says: no param, because what comes out does not depend on it.

    Raises:
        ParamsError: the variable is no positive whole number.
    """
    return _positive(PROCESSES, 1 if gpu else available_cores())


def training_workers() -> int:
    """Return how many workers of a cluster train one ensemble together: 1, or what `ADDRESSED_DYNAMICS_WORKERS` says.

    Raises:
        ParamsError: the variable is no positive whole number, or there is no cluster whose workers these could be.
    """
    workers = _positive(WORKERS, 1)
    if workers > 1 and engine() is None:
        message = f"{WORKERS} is {workers}, but the workers are those of a cluster; say which one in {ENGINE}"
        raise ParamsError(message)
    return workers


def _positive(variable: str, default: int) -> int:
    asked = os.environ.get(variable)
    if asked is None:
        return default
    if not asked.isdecimal() or int(asked) < 1:
        message = f"{variable} should be a positive whole number, but is '{asked}'; unset it for {default}"
        raise ParamsError(message)
    return int(asked)


def progress(description: str, unit: str, total: int | None = None) -> "tqdm[NoReturn]":
    """Return a progress bar with rate and remaining time; where nobody watches it, it writes a line now and then."""
    interval = 0.2 if sys.stderr.isatty() else 15.0
    return tqdm(
        desc=description, unit=unit, total=total, unit_scale=True, mininterval=interval, maxinterval=2 * interval
    )


def say(line: str) -> None:
    """Tell whoever watches a stage, or reads its log later."""
    print(line, file=sys.stderr)


def counted(rows: Mapping[str, Mapping[str, int]]) -> str:
    """Return how much each split has, in words: the largest of its counts, which is that of its rows."""
    return ", ".join(f"{max(counts.values()):,} for {split}" for split, counts in rows.items())


def first_of(figures: Mapping[str, float], number: int = 3) -> str:
    """Return the first figures of a summary in words."""
    return ", ".join(f"{name.replace('_', ' ')} {value:.4g}" for name, value in [*figures.items()][:number])


def median_of(results: Mapping[str, Mapping[str, Any]], name: str) -> str:
    """Return a metric of some trainings in words: its median, if there are several."""
    values = [each[name] for each in results.values() if name in each]
    return f"{median(values):.3g}{f' (median of {len(values)})' if len(values) > 1 else ''}"


class _Terminated(BaseException):
    """SIGTERM, as an exception that cleans up on its way, like Ctrl-C."""


@dataclass(frozen=True)
class Call:
    """What a stage is called with."""

    experiment: str
    """Name of the experiment, a section of the params file."""
    params_file: Path
    """The params file."""
    kind: str
    """The experiment's kind of data."""
    path: Path
    """What the stage reads that is not made by a training: raw data, or what is to be imported."""


def run_stage(main: Callable[[Call], str | None]) -> NoReturn:
    """Call `main` with the options of the command line, say the line that it returns, then exit.

    The status is 0 if all went well, 1 after a project error or an error of the system (a full disk), 130 after Ctrl-C
    and 143 after SIGTERM; then stderr ends in one line that says what happened. Any other exception is a bug and shows
    its traceback.
    """
    parser = argparse.ArgumentParser(description=sys.modules[main.__module__].__doc__)
    parser.add_argument("experiment", help="section of the params file, for instance mountaincar")
    parser.add_argument("--params", required=True, type=Path, help="params file, for instance params.yaml")
    parser.add_argument("--kind", default="transitions", help="kind of data: transitions or motion")
    parser.add_argument("--path", type=Path, help="file or folder to convert or to import")
    options = parser.parse_args()
    call = Call(options.experiment, options.params, options.kind, options.path or raw_dir(options.experiment))

    def stage() -> None:
        _say_what_is_replaced(call)
        if line := main(call):
            say(f"{call.experiment}: {line}")

    _end_well(stage)


def _say_what_is_replaced(call: Call) -> None:
    """Say which params do not hold because another file lies over them: a change of those would change nothing."""
    replaced = replaced_keys(call.params_file, call.experiment)
    if replaced:
        more = f" and {len(replaced) - REPLACED_SHOWN} more" if len(replaced) > REPLACED_SHOWN else ""
        say(f"{call.params_file} takes the place of {', '.join(replaced[:REPLACED_SHOWN])}{more}")


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
