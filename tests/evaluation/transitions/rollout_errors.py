"""What rollouts of one model come to, as the evaluation computes it."""

import numpy as np

from addressed_dynamics.evaluation.transitions.rollouts import finite, free_run, squared_errors
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode


def rollout_errors(model: AddressedDynamics, truth: TrueRollouts, mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Return the squared errors of a model's rollouts, and the predicted states, (episode, step, observation)."""
    predicted = free_run(model, truth, mode)
    return squared_errors(predicted, truth), finite(predicted)
