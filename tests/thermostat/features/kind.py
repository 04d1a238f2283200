"""From temperatures to samples: the next one from the last."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from addressed_dynamics.sources.thermostat.params import FeatureParams, ThermostatParams

from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.common.spool import Spool
from addressed_dynamics.features.common.training_data import TrainingData


@dataclass(frozen=True)
class ThermostatFeatures:
    """Temperatures divided by a constant."""

    scale: float
    inputs: int = 1
    outputs: int = 1

    def loss_unit(self, loss: str) -> float:
        """Return what one unit of the loss is in degrees."""
        return self.scale**2 if loss == "mse" else self.scale

    def to_json(self) -> dict[str, Any]:
        """Return the features as JSON-compatible values."""
        return {"kind": "thermostat", **asdict(self)}

    @staticmethod
    def from_json(value: dict[str, Any]) -> "ThermostatFeatures":
        """Return the features of what `to_json` gave."""
        return ThermostatFeatures(value["scale"])

    def samples(self, values: np.ndarray) -> Samples:
        """Return every temperature with the one after it."""
        scaled = torch.from_numpy(values).unsqueeze(1) / self.scale
        steps = torch.arange(len(scaled) - 1)
        return Samples(scaled[:-1], scaled[1:], torch.zeros_like(steps), steps)


FEATURES = ThermostatFeatures
PHASE_FEATURES = None


def load_training_data(
    tables: Path,
    sections: ThermostatParams,
    features: FeatureParams | ThermostatFeatures,
    *,
    augmented: bool = True,
    spool: Spool | None = None,
) -> TrainingData[ThermostatFeatures]:
    """Read the samples, with features to be made or those of a model."""
    del sections, augmented, spool
    spec = ThermostatFeatures(features.scale)
    with np.load(tables / "values.npz") as arrays:
        samples = spec.samples(arrays["train"])
    return TrainingData(spec, samples, samples)
