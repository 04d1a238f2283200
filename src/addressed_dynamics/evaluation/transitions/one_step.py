"""One-step errors in the environment's units and of states scaled to [0, 1]."""

from collections.abc import Callable, Iterator
from typing import Any

import torch
from jaxtyping import Float, Float64
from torch import Tensor

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.features.common.spool import IN_MEMORY, Scratch
from addressed_dynamics.features.transitions.angles import wrapped_difference
from addressed_dynamics.features.transitions.spec import Angle

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

    def predict(rows: slice) -> Tensor:
        predicted = predictor(points, torch.arange(rows.start, rows.stop))
        if not torch.isfinite(predicted).all():
            message = "a model predicts states that are not finite: its training diverged"
            raise EvaluationError(message)
        return predicted

    return points.each(predict)


def scaled_losses(predicted: Float[Tensor, "point observation"], points: Points, loss: str) -> Float[Tensor, " point"]:
    """Return each point's loss (`mse` or `mae`) of states scaled to [0, 1], the paper's unit.

    It is over the dimensions that a network predicts, not over velocities that follow from angles.
    """
    truth, predicts = torch.from_numpy(points.next_observation), points.features.predicted
    scale = torch.tensor(points.features.scale, dtype=torch.float64)[list(predicts)]

    def losses(rows: slice) -> Tensor:
        error = (predicted[rows] - truth[rows]).double()[..., predicts] / scale
        return (error.square() if loss == "mse" else error.abs()).mean(dim=-1)

    return points.each(losses)


def summarise(losses: Float[Tensor, " sample"], scratch: Scratch = IN_MEMORY) -> dict[str, float]:
    """Return mean, median, 99th percentile and maximum of `losses`; all 0 if there are none.

    Args:
        losses: at least 0, and finite.
        scratch: where as many numbers may lie.
    """
    return _of_sorted(_sorted(losses, scratch))


def errors_per_dimension(predicted: Float[Tensor, "point observation"], points: Points) -> list[dict[str, Any]]:
    """Return the squared and absolute one-step error of each dimension of the state and of each angle, in its unit."""
    found = []
    for name, unit, absolute in _absolute_errors(predicted, points, angles=True):
        summary = {"absolute": _of_sorted(absolute)}
        # What is sorted is so when it is squared, too.
        found.append({"name": name, "unit": unit, "squared": _of_sorted(absolute.square_()), **summary})
    return found


def squared_errors_per_dimension(predicted: Float[Tensor, "point observation"], points: Points) -> list[dict[str, Any]]:
    """Return the same of the dimensions of the state and without the absolute errors."""
    return [
        {"name": name, "unit": unit, "squared": _of_sorted(absolute.square_())}
        for name, unit, absolute in _absolute_errors(predicted, points, angles=False)
    ]


def _absolute_errors(
    predicted: Float[Tensor, "point observation"], points: Points, *, angles: bool
) -> Iterator[tuple[str, str, Float64[Tensor, " point"]]]:
    """Yield name, unit and sorted absolute errors of each dimension, and of each angle if asked for."""
    features, truth = points.features, torch.from_numpy(points.next_observation)
    for index, dimension in enumerate(features.spaces.observation):

        def apart(rows: slice, index: int = index) -> Tensor:
            return (predicted[rows, index] - truth[rows, index]).double().abs()

        yield dimension.name, dimension.unit, _sort(points.each(apart))
    for angle in features.angles if angles else ():

        def turned(rows: slice, angle: Angle = angle) -> Tensor:
            found, true = (features.angle(angle, states[rows].double()) for states in (predicted, truth))
            return wrapped_difference(found, true).abs()

        yield angle.name, "rad", _sort(points.each(turned))


def _sorted(values: Float[Tensor, " sample"], scratch: Scratch) -> Float64[Tensor, " sample"]:
    copied = scratch(len(values), torch.float64)
    for rows in scratch.blocks(len(values)):
        copied[rows] = values[rows]
    return _sort(copied)


def _sort(values: Float64[Tensor, " sample"]) -> Float64[Tensor, " sample"]:
    """Sort values where they lie: a file that is mapped is read and written in order, again and again."""
    values.numpy().sort()
    return values


def _of_sorted(ordered: Float64[Tensor, " sample"]) -> dict[str, float]:
    if not len(ordered):
        return {"mean": 0.0, "median": 0.0, "p99": 0.0, "max": 0.0}
    return {
        "mean": float(ordered.mean()),
        "median": float(_quantile(ordered, 0.5)),
        "p99": float(_quantile(ordered, 0.99)),
        "max": float(ordered[-1]),
    }


def _quantile(ordered: Float[Tensor, " sample"], share: float) -> Tensor:
    """Return a quantile of sorted values by linear interpolation, for any number of them."""
    place = share * (len(ordered) - 1)
    below = int(place)
    above = min(below + 1, len(ordered) - 1)
    return torch.lerp(ordered[below], ordered[above], place - below)
