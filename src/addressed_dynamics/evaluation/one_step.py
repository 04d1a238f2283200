"""One-step errors in the environment's units and of states scaled to [0, 1]."""

from collections.abc import Callable, Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.errors import EvaluationError
from addressed_dynamics.models.stacked import in_chunks
from addressed_dynamics.transitions import Dimension, Transitions

Predictor = Callable[[Tensor, Tensor], Tensor]
"""(states (B, d_obs), actions) -> next states (B, d_obs), in the environment's units."""


def predict_all(predictor: Predictor, test: Transitions) -> Float[Tensor, "sample observation"]:
    """Return the predicted next state of every test transition, in the environment's units.

    Raises:
        EvaluationError: there are no test transitions, or a prediction is not finite.
    """
    if not len(test):
        message = "there are no test episodes: raise convert.test_share or record more episodes"
        raise EvaluationError(message)
    observation, action = torch.from_numpy(test.observation), torch.from_numpy(test.action)
    rows = torch.arange(len(test))
    predicted = in_chunks(lambda row: predictor(observation[row], action[row]), rows, sample_dim=0)
    if not torch.isfinite(predicted).all():
        message = "a model predicts states that are not finite: its training diverged"
        raise EvaluationError(message)
    return predicted


def scaled_losses(
    predicted: Float[Tensor, "*member sample observation"], test: Transitions, scale: Sequence[float], loss: str
) -> Float[Tensor, "*member sample"]:
    """Return each sample's loss (`mse` or `mae`) of states divided by `scale`, the paper's unit."""
    error = (predicted - torch.from_numpy(test.next_observation)).double() / torch.tensor(scale, dtype=torch.float64)
    return (error.square() if loss == "mse" else error.abs()).mean(dim=-1)


def summarise(losses: Float[Tensor, " sample"]) -> dict[str, float]:
    """Return mean, median, 99th percentile and maximum of `losses`; all 0 if there are none."""
    if not len(losses):
        return {"mean": 0.0, "median": 0.0, "p99": 0.0, "max": 0.0}
    ordered = losses.double().sort().values
    return {
        "mean": float(ordered.mean()),
        "median": float(_quantile(ordered, 0.5)),
        "p99": float(_quantile(ordered, 0.99)),
        "max": float(ordered[-1]),
    }


def errors_per_dimension(
    predicted: Float[Tensor, "sample observation"], test: Transitions, dimensions: Sequence[Dimension]
) -> list[dict[str, Any]]:
    """Return, for each dimension of the state, its squared and absolute one-step error in its own unit."""
    error = (predicted - torch.from_numpy(test.next_observation)).double()
    return [
        {
            "name": dimension.name,
            "unit": dimension.unit,
            "squared": summarise(error[:, index].square()),
            "absolute": summarise(error[:, index].abs()),
        }
        for index, dimension in enumerate(dimensions)
    ]


def _quantile(ordered: Float[Tensor, " sample"], share: float) -> Tensor:
    """Return a quantile of sorted values by linear interpolation, for any number of them."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return torch.lerp(ordered[below], ordered[above], place - below)
