"""One-step errors in the environment's units and of states scaled to [0, 1]."""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.transitions.angles import wrapped_difference
from addressed_dynamics.networks.stacked import in_chunks

Predictor = Callable[[Points, Tensor], Tensor]
"""(points, numbers of some of them (B,)) -> their next states (B, d_obs), in the environment's units."""


def predict_all(predictor: Predictor, points: Points) -> Float[Tensor, "point observation"]:
    """Return the predicted next state of every point, in the environment's units.

    Raises:
        EvaluationError: there are no points, or a prediction is not finite.
    """
    if not len(points):
        frames = "" if points.features.history == 1 else f" of at least {points.features.history} steps"
        message = f"there are no test episodes{frames}: raise convert.test_share or record more episodes"
        raise EvaluationError(message)
    predicted = in_chunks(lambda point: predictor(points, point), torch.arange(len(points)), sample_dim=0)
    if not torch.isfinite(predicted).all():
        message = "a model predicts states that are not finite: its training diverged"
        raise EvaluationError(message)
    return predicted


def scaled_losses(
    predicted: Float[Tensor, "*member point observation"], points: Points, loss: str
) -> Float[Tensor, "*member point"]:
    """Return each point's loss (`mse` or `mae`) of states scaled to [0, 1], the paper's unit.

    It is over the dimensions that a network predicts, not over velocities that follow from angles.
    """
    error = (predicted - torch.from_numpy(points.next_observation)).double()
    predicts = points.features.predicted
    error = error[..., predicts] / torch.tensor(points.features.scale, dtype=torch.float64)[list(predicts)]
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


def errors_per_dimension(predicted: Float[Tensor, "point observation"], points: Points) -> list[dict[str, Any]]:
    """Return the squared and absolute one-step error of each dimension of the state and of each angle, in its unit."""
    features, truth = points.features, torch.from_numpy(points.next_observation)
    errors = {
        (dimension.name, dimension.unit): (predicted[:, index] - truth[:, index]).double()
        for index, dimension in enumerate(features.spaces.observation)
    }
    for angle in features.angles:
        found, true = (features.angle(angle, states.double()) for states in (predicted, truth))
        errors[angle.name, "rad"] = wrapped_difference(found, true)
    return [
        {"name": name, "unit": unit, "squared": summarise(error.square()), "absolute": summarise(error.abs())}
        for (name, unit), error in errors.items()
    ]


def _quantile(ordered: Float[Tensor, " sample"], share: float) -> Tensor:
    """Return a quantile of sorted values by linear interpolation, for any number of them."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return torch.lerp(ordered[below], ordered[above], place - below)
