"""What any model has to beat: nothing changes, the last change goes on, and the best linear map, all in closed form."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from addressed_dynamics.features.common.samples import BLOCK_ROWS, Samples
from addressed_dynamics.features.common.training_data import AnyFeatures, TrainingData
from addressed_dynamics.networks.ridge import PENALTIES, Chunks, Moments, moments, solve
from addressed_dynamics.networks.stacked import StackedMLP

PERSISTENCE, LAST_CHANGE, LINEAR, LINEAR_FRAME = "persistence", "last_change", "linear", "linear_frame"
"""Names of the references: two that repeat what was, and the linear maps of all that a network is given and of its last
frame."""
UNTRAINED = (PERSISTENCE, LAST_CHANGE, LINEAR, LINEAR_FRAME)
"""All of them."""


def reference_networks(data: TrainingData[AnyFeatures]) -> Iterator[tuple[str, StackedMLP]]:
    """Yield the references as networks without hidden layers, by name; none if the kind has others.

    The last change and the linear map of the last frame are there where a network is given frames before it. A linear
    map has the lowest mean squared error on the training samples under a small penalty, the one with the lowest error
    on the validation samples; if there are none, the smallest.
    """
    if data.persistence is None:
        return
    yield PERSISTENCE, _network(*data.persistence)
    if data.last_change is not None:
        yield LAST_CHANGE, _network(*data.last_change)
    found = moments(_chunks(data.train))
    yield LINEAR, _least_squares(found, data.validation)
    if data.last_frame is not None:
        yield LINEAR_FRAME, _least_squares(found, data.validation, data.last_frame)


def reference_costs(name: str, inputs: int, outputs: int, last_frame: int | None) -> tuple[int, int]:
    """Return the parameters and the multiply-adds a step of a reference by its name; what repeats what was has none.

    Args:
        name: one of `UNTRAINED`.
        inputs: inputs of a network.
        outputs: its outputs.
        last_frame: inputs that are of the last frame; None if all of them are.
    """
    if name in (PERSISTENCE, LAST_CHANGE):
        return 0, 0
    used = last_frame if name == LINEAR_FRAME and last_frame is not None else inputs
    return (used + 1) * outputs, used * outputs


def _least_squares(found: Moments, validation: Samples, given: int | None = None) -> StackedMLP:
    """Return the best linear map of the last `given` inputs, of all of them if None."""
    inputs = len(found.x_mean)
    before = 0 if given is None else inputs - given
    seen = slice(before, inputs)
    part = replace(found, x_mean=found.x_mean[seen], xx=found.xx[seen, seen], xy=found.xy[seen])
    maps = [(torch.nn.functional.pad(each.weight, (0, 0, before, 0)), each.bias) for each in solve(part, PENALTIES)]
    errors = [_squared_error(*each, validation) for each in maps]
    return _network(*maps[min(range(len(errors)), key=errors.__getitem__)])


def _network(weight: Tensor, bias: Tensor) -> StackedMLP:
    network = StackedMLP(1, tuple(weight.shape), "relu")
    with torch.no_grad():
        network.weights[0].copy_(weight.unsqueeze(0))
        network.biases[0].copy_(bias.view(1, 1, -1))
    return network


def _squared_error(weight: Tensor, bias: Tensor, samples: Samples) -> float:
    return sum(
        float((torch.from_numpy(x) @ weight + bias - torch.from_numpy(y)).square().double().sum())
        for x, y in _chunks(samples)
    )


def _chunks(samples: Samples) -> Chunks:
    for first in range(0, len(samples), BLOCK_ROWS):
        rows = slice(first, first + BLOCK_ROWS)
        yield samples.x[rows].numpy(), samples.y[rows].numpy()
