"""What the evaluation of an experiment comes to."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.base.criteria import Criterion
from addressed_dynamics.base.files import save_arrays, write_json, write_rows
from addressed_dynamics.evaluation.common.measures import MEASURES, Row, rows_of, write_rows_of_measures
from addressed_dynamics.simulators.calibrated import Calibrated
from addressed_dynamics.simulators.delivery import Delivered
from addressed_dynamics.simulators.rewards import KeptTask
from addressed_dynamics.simulators.serving import Served
from addressed_dynamics.simulators.starts import Starts


@dataclass(frozen=True)
class Evaluated:
    """All that is measured of an experiment's models."""

    report: dict[str, Any]
    """What goes into evaluation.json."""
    arrays: Mapping[str, np.ndarray]
    """What figures are made of."""
    curves: Mapping[str, list[dict[str, Any]]]
    """Rows of CSV files, by the file's name."""
    headline: dict[str, float]
    """The figures that a table of runs should show."""
    summary: dict[str, float]
    """The few figures that are in Git."""
    delivered: Delivered
    """The model that is delivered."""
    measures: Sequence[Row] = ()
    """What has no section of its own in the report."""
    calibrated: Sequence[Calibrated] = ()
    """How far models are to be trusted."""
    uncalibrated: str | None = None
    """Why that is known of none; None if it is of some."""
    starts: Starts | None = None
    """Where a learned environment starts; None if models of this kind of data make none."""
    criteria: Sequence[Criterion] = ()
    """What the delivered model reaches on validation data, what counts most first; nothing if that was not measured."""
    figures: Mapping[str, float] = field(default_factory=dict)
    """What it reaches on test data."""
    load_served: Callable[[Path], Served] | None = None
    """Loads what is delivered of a folder of models as a function of a table; None if models of this kind of data are
    none."""
    task: KeptTask | None = None
    """Who says reward and end there; None as above."""


def write_evaluated(found: Evaluated, folder: Path) -> None:
    """Write what an evaluation came to into a new folder: numbers, as a tree and as a table, arrays and curves."""
    folder.mkdir()
    save_arrays(folder / "arrays.npz", dict(found.arrays))
    for name, rows in found.curves.items():
        write_rows(folder / f"{name}.csv", rows)
    write_json(folder / "evaluation.json", found.report)
    write_rows_of_measures(folder / MEASURES, [*rows_of(found.report.get("candidates", {})), *found.measures])
