"""What the trainings found, of any kind of data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from addressed_dynamics.evaluation.common.records import Record
from addressed_dynamics.reporting.common.reading import Columns, read_csv, read_json


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


def read_trainings(figures: Path) -> dict[str, Any]:
    """Read the fields of `Trainings` from the folder of what the stages found, one folder a stage.

    Raises:
        ReportError: a file is missing or malformed.
    """
    folder = figures / "addressing"
    return {
        "addressing": read_json(folder / "addressing.json", AddressingTrainings),
        "baselines": read_json(figures / "baselines" / "baselines.json", dict[str, dict[str, float]]),
        "ensemble_curves": read_csv(
            figures / "ensemble" / "ensemble.csv", by="training", needed=("epoch", "loss/train")
        ),
        "addressing_curves": read_csv(folder / "addressing.csv", by="training", needed=("epoch", "agreement")),
    }
