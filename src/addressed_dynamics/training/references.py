"""What any model has to beat: that nothing changes, and the best linear map. Both are found in closed form."""

from __future__ import annotations

from collections.abc import Iterator

import torch
from torch import Tensor

from addressed_dynamics.features.common.samples import BLOCK_ROWS, Samples
from addressed_dynamics.features.common.training_data import AnyFeatures, TrainingData
from addressed_dynamics.networks.ridge import PENALTIES, Chunks, moments, solve
from addressed_dynamics.networks.stacked import StackedMLP

PERSISTENCE, LINEAR = "persistence", "linear"
"""Names of the references."""


def reference_networks(data: TrainingData[AnyFeatures]) -> Iterator[tuple[str, StackedMLP]]:
    """Yield the references as networks without hidden layers, by name; none if the kind has others.

    The linear map has the lowest mean squared error on the training samples under a small penalty, the one with the
    lowest error on the validation samples; if there are none, the smallest.
    """
    if data.persistence is None:
        return
    yield PERSISTENCE, _network(*data.persistence)
    candidates = list(solve(moments(_chunks(data.train)), PENALTIES))
    errors = [_squared_error(each.weight, each.bias, data.validation) for each in candidates]
    best = candidates[min(range(len(errors)), key=errors.__getitem__)]
    yield LINEAR, _network(best.weight, best.bias)


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
