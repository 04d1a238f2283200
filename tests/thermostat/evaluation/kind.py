"""How far the next temperature is from what an ensemble says."""

from pathlib import Path

import numpy as np
import torch
from addressed_dynamics.features.thermostat.kind import ThermostatFeatures
from addressed_dynamics.sources.thermostat.params import EvaluationParams

from addressed_dynamics.evaluation.common.evaluated import Evaluated
from addressed_dynamics.features.common.spool import Spool
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.networks.files import addressed_folders, load_network
from addressed_dynamics.simulators.delivery import Delivered


def evaluate(tables: Path, models: Path, params: EvaluationParams, *, cores: int, spool: Spool) -> Evaluated:
    """Evaluate the ensemble on temperatures that it has not seen."""
    del cores, spool
    ensemble, addressing = (load_network(each, ThermostatFeatures) for each in addressed_folders(models, 0, None))
    with np.load(tables / "values.npz") as arrays:
        samples = ensemble.features.samples(arrays["test"])
    chosen = addressing_scores(addressing.stack, samples.x).argmax(dim=1)
    with torch.no_grad():
        error = (ensemble.stack.forward_routed(samples.x, chosen) - samples.y).abs() * ensemble.features.scale
    found = {"mean_error": error.mean().item()} | ({"worst_error": error.max().item()} if params.worst else {})
    return Evaluated(
        found, {"error": error.numpy()}, {}, found, found, Delivered(0, None, "argmax"), uncalibrated="nobody asks"
    )
