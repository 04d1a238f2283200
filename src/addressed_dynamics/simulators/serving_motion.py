"""A model of motion as a function of a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import final

import numpy as np

from addressed_dynamics.episodes.layout import INPUT, OUTPUT
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.serving import NamedColumn, Served, stacked
from addressed_dynamics.sources.motion.tables import INPUTS, OUTPUTS

PHASE = "phase"


@final
class ServedMotion(Served):
    """One frame of a model: the columns are those of the Parquet tables, and the phase if the model has one."""

    def __init__(self, model: MotionModel) -> None:
        """Look at what a model takes."""
        self.model = model
        phase = (NamedColumn(PHASE, "cycles", 0.0, 1.0),) if model.mode == "phase" else ()
        self.inputs = (*map(NamedColumn, INPUTS, INPUT.units), *phase)
        self.outputs = tuple(map(NamedColumn, OUTPUTS, OUTPUT.units))
        self.settings: Mapping[str, float] = {}
        origin = model.origin
        self.facts = {
            "kind": "motion",
            "mode": model.mode,
            **({} if origin is None else {"candidate": origin.candidate, "seed": str(origin.seed)}),
            **({} if origin is None or origin.variant is None else {"variant": origin.variant}),
        }

    def answer(self, columns: Mapping[str, np.ndarray], settings: Mapping[str, float]) -> dict[str, np.ndarray]:  # noqa: ARG002 - a form for all
        """Return the outputs of frames.

        Raises:
            ModelError: a value is not finite.
        """
        phase = columns[PHASE] if self.model.mode == "phase" else None
        found = self.model.predict(stacked(columns, INPUTS), phase=phase)
        return dict(zip(OUTPUTS, found.T, strict=True))

    def example(self) -> dict[str, np.ndarray]:
        """Return the mean of the training inputs, and what is one deviation from it."""
        mean, deviation = np.array(self.model.features.input_mean), np.array(self.model.features.input_deviation)
        rows = np.stack([mean, mean + deviation])
        phase = {PHASE: np.array([0.0, 0.5])} if self.model.mode == "phase" else {}
        return dict(zip(INPUTS, rows.T, strict=True)) | phase


def load_served(folder: Path) -> ServedMotion:
    """Load what is delivered of the models in a folder as a function of a table.

    Raises:
        ModelError: a file is missing or damaged.
    """
    return ServedMotion(MotionModel.load(folder))


def _load_pyfunc(path: str) -> ServedMotion:
    """Load a model; MLflow calls it."""
    return load_served(Path(path))
