"""What was found of each experiment, as its report begins."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import experiment_names

REPORTS = Path("data") / "reports"
"""Folder of the reports, beside the params file."""


def verdict_lines(params_file: Path, wanted: Sequence[str] = ()) -> Iterator[str]:
    """Yield the verdict of each experiment that the pipeline runs, with the path of its report.

    Args:
        params_file: where the experiments are.
        wanted: only these; all of them by default.

    Raises:
        ParamsError: the params file is missing or is not YAML, or names no experiments, or not one of those wanted.
    """
    names = experiment_names(params_file)
    if not names:
        message = f"{params_file}: there are no experiments in it; 'addressed-dynamics new NAME LOGS' makes one"
        raise ParamsError(message)
    if unknown := [name for name in wanted if name not in names]:
        message = f"{params_file}: there is no experiment '{unknown[0]}' in it; there are {', '.join(names)}"
        raise ParamsError(message)
    for name in wanted or names:
        folder = params_file.parent / REPORTS / name
        report, verdict = folder / "report.html", folder / "verdict.txt"
        if report.is_file() and verdict.is_file():
            yield f"{name}: {' '.join(verdict.read_text(encoding='utf-8').split())} {report}"
        else:
            yield f"{name}: no report yet; 'dvc repro report@{name}' makes it"
