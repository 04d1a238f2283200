"""How much of what changes in a step a model explains: 100 % less its squared error in % of that of "nothing changes".

Below 0 % a model is worse than the state before the step.
"""

from collections.abc import Iterator

import numpy as np

from addressed_dynamics.evaluation.common.measures import Row
from addressed_dynamics.evaluation.transitions.candidates import Candidate
from addressed_dynamics.evaluation.transitions.one_step import predict_all
from addressed_dynamics.evaluation.transitions.points import Points


def measure(candidate: Candidate, held_out: Points) -> Iterator[Row]:
    """Yield the share for each dimension of the state; nothing for one that never changes."""
    truth = held_out.next_observation.astype(np.float64)
    error = predict_all(candidate.predictor, held_out).numpy() - truth
    change = held_out.observation - truth
    for index, dimension in enumerate(held_out.features.spaces.observation):
        nothing = float((change[:, index] ** 2).mean())
        if nothing > 0:
            share = 1 - float((error[:, index] ** 2).mean()) / nothing
            yield Row("explained", candidate.name, dimension.name, "share", 100 * share, "%")
