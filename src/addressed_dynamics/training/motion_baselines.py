"""How the baselines of a motion experiment are trained: as many updates as the ensemble."""

from __future__ import annotations

import math

from addressed_dynamics.base.params.motion import BlendedNetwork, BlendedTraining, MotionFeatureParams
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.training.baselines import as_single, hidden_of_total_parameters
from addressed_dynamics.training.epochs import updates_per_epoch

PFNN_FEATURES = MotionFeatureParams(target="absolute", joint_input_weight=0.1)
"""What a phase-functioned network is given and asked for (Holden, Komura, Saito 2017)."""


def blended_training(network: BlendedNetwork, ensemble: EnsembleParams, samples: int) -> BlendedTraining:
    """Return the training of a blended network that makes as many updates as the ensemble, up to a whole epoch."""
    updates = ensemble.epochs * updates_per_epoch(samples, ensemble.members, ensemble.batch_size)
    epochs = math.ceil(updates / updates_per_epoch(samples, 1, network.batch_size))
    return BlendedTraining(**network.model_dump(), epochs=epochs)


def same_size(ensemble: EnsembleParams, samples: int) -> EnsembleParams:
    """Return the training of one network like a member."""
    return as_single(ensemble, {}, samples)


def total_parameters(ensemble: EnsembleParams, inputs: int, outputs: int, samples: int) -> EnsembleParams:
    """Return the training of one network with as many parameters as the ensemble."""
    hidden = hidden_of_total_parameters(inputs, outputs, ensemble.hidden, ensemble.members)
    return as_single(ensemble, {"hidden": hidden}, samples)
