"""How much of what changes in a step a model explains: 100 % less its squared error in % of that of "nothing changes".

Below 0 % a model is worse than the state before the step.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float32

from addressed_dynamics.evaluation.common.measures import Row
from addressed_dynamics.evaluation.transitions.candidates import Candidate
from addressed_dynamics.evaluation.transitions.one_step import predict_all
from addressed_dynamics.evaluation.transitions.points import Points


def measure(candidate: Candidate, held_out: Points) -> Iterator[Row]:
    """Yield the share for each dimension of the state; nothing for one that never changes."""
    predicted = predict_all(candidate.predictor, held_out).numpy()
    for index, dimension in enumerate(held_out.features.spaces.observation):
        error, nothing = (
            _mean_square(states[:, index], held_out, index) for states in (predicted, held_out.observation)
        )
        if nothing > 0:
            share = 1 - error / nothing
            yield Row("explained", candidate.name, dimension.name, "share", 100 * share, "%")


def _mean_square(states: Float32[np.ndarray, " point"], held_out: Points, index: int) -> float:
    """Return the mean squared difference of a dimension from what followed."""
    truth = held_out.next_observation[:, index]
    squares = held_out.scratch.filled(len(held_out), lambda rows: (states[rows] - truth[rows].astype(np.float64)) ** 2)
    return float(squares.mean())
