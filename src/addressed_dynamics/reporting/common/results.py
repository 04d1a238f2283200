"""What the earlier stages found of any kind of data, read and checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from addressed_dynamics.evaluation.common.records import Record
from addressed_dynamics.reporting.common.reading import Columns, read_arrays, read_csv_if_there, read_json

Data = TypeVar("Data")
Evaluation = TypeVar("Evaluation")
Arrays = TypeVar("Arrays")


class AddressingTrainings(Record):
    """addressing.json: validation metrics of each addressing network, by `seed-0/plain` and so on."""

    delivered: dict[str, str]
    validation: dict[str, dict[str, Any]]


@dataclass(frozen=True)
class Trainings:
    """What the stages between the data and the evaluation found."""

    addressing: AddressingTrainings
    baselines: dict[str, dict[str, float]]
    """baselines.json: last metrics of each baseline, with `parameters`, `updates` and, if known, `samples`."""
    ensemble_curves: Mapping[str, Columns]
    """ensemble.csv by training."""
    addressing_curves: Mapping[str, Columns]
    """addressing.csv by training."""


@dataclass(frozen=True)
class Results(Trainings, Generic[Data, Evaluation, Arrays]):
    """All that a report is made from; a kind says of what form the three are that differ, and may add to them."""

    data: Data
    """data.json."""
    evaluation: Evaluation
    """evaluation.json."""
    arrays: Arrays
    """arrays.npz: what the figures show."""


def read_results(
    figures: Path,
    evaluation: Path,
    data: type[Data],
    found: type[Evaluation],
    arrays: Callable[[Mapping[str, np.ndarray]], Arrays],
) -> dict[str, Any]:
    """Read the fields of `Results`.

    Args:
        figures: folder of what the stages before the evaluation found, one folder a stage.
        evaluation: folder of what the evaluation found.
        data: form of data.json.
        found: form of evaluation.json.
        arrays: what becomes of the arrays, as in `read_arrays`.

    Raises:
        ReportError: a file is missing or malformed.
    """
    return {
        **read_trainings(figures),
        "data": read_json(figures / "convert" / "data.json", data),
        "evaluation": read_json(evaluation / "evaluation.json", found),
        "arrays": read_arrays(evaluation / "arrays.npz", arrays),
    }


def read_trainings(figures: Path) -> dict[str, Any]:
    """Read the fields of `Trainings` from the folder of what the stages found, one folder a stage.

    Raises:
        ReportError: a file is missing or malformed.
    """
    folder = figures / "addressing"
    return {
        "addressing": read_json(folder / "addressing.json", AddressingTrainings),
        "baselines": read_json(figures / "baselines" / "baselines.json", dict[str, dict[str, float]]),
        **read_curves(figures),
    }


def read_curves(figures: Path) -> dict[str, dict[str, Columns]]:
    """Read the curves of the trainings, as in `Trainings`; those of a training that was not run are empty.

    Raises:
        ReportError: a file is malformed.
    """
    return {
        "ensemble_curves": read_csv_if_there(
            figures / "ensemble" / "ensemble.csv", by="training", needed=("epoch", "loss/train")
        ),
        "addressing_curves": read_csv_if_there(
            figures / "addressing" / "addressing.csv", by="training", needed=("epoch", "agreement")
        ),
    }
