"""`features.history: auto`: how many frames networks are given, by what a network of a random layer makes of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import torch
from jaxtyping import Float64, Int64
from torch import Tensor

from addressed_dynamics.base.torch_runtime import named_generator
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.samples import BLOCK_ROWS, Samples
from addressed_dynamics.features.common.training_data import Choice
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.features.transitions.windows import episode_lengths, parts_of
from addressed_dynamics.sources.transitions.params import HISTORIES, FeatureParams

LEAST_SHARE = 0.9
"""Share of the training transitions that must have so many frames of their episode before them."""
ABOUT_AS_GOOD = 1.02
"""A mean squared error that is no larger than so many times the lowest is about as good."""
NEGLIGIBLE = 1e-12
"""A mean squared error below which all are as good: a millionth of the range, hardly more than float32 can tell."""
UNITS = 200
"""Units of the random layer."""
PENALTIES = (1e-8, 1e-6, 1e-4, 1e-2, 1.0)
"""Penalties that are tried, of the squared weights of the layer beside the mean squared error of normalised targets."""
LINEAR_PENALTY = 1e-12
"""That of the frames' own weights: inputs may depend on each other, as those of a discrete action do."""


def choose_history(
    train: Transitions | Iterable[Transitions],
    validation: Transitions | Iterable[Transitions],
    sampled: Callable[[FeatureSpec], AbstractContextManager[tuple[Samples, Samples]]] | None = None,
) -> Choice:
    """Return the smallest number of frames from which the next state is predicted about as well as from the best.

    What predicts is linear in the frames and in a layer of tanh units with random weights, and so found in closed form.
    (A map that is linear in the frames alone takes older ones for what is not linear in the last.) Numbers are compared
    by the mean squared error, of states in [0, 1], on the same validation transitions: those with the most frames
    before them. Targets and angles have no say, so that all recipes of an experiment choose alike.

    Args:
        train: training transitions, whole or in parts, to be read again and again.
        validation: validation transitions, in the same way.
        sampled: gives the samples of both under some features, for as long as they are needed; None: in memory.
    """
    lengths, judged = episode_lengths(parts_of(train)), episode_lengths(parts_of(validation))
    tried = [each for each in HISTORIES if each == 1 or _samples(lengths, each) >= LEAST_SHARE * lengths.sum()]
    if len(tried) == 1 or not _samples(judged, tried[-1]):
        return Choice(1)
    errors = dict[int, float]()
    for history in tried:
        features = fit_features(train, FeatureParams(history=history))
        # Of each episode, the samples that the longest history has: its last ones.
        counts = np.maximum(judged - (history - 1), 0)
        later = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts) >= tried[-1] - history
        with (
            sampled(features) if sampled else nullcontext((features.samples(train), features.samples(validation))) as (
                on_train,
                on_validation,
            )
        ):
            error = _lowest_error(on_train, on_validation, torch.from_numpy(np.flatnonzero(later)))
        errors[history] = error * features.loss_unit("mse")
    enough = max(ABOUT_AS_GOOD * min(errors.values()), NEGLIGIBLE)
    best = min(history for history, error in errors.items() if error <= enough)
    return Choice(best, {str(history): {"mse": error} for history, error in errors.items()})


def _samples(lengths: Int64[np.ndarray, " episode"], history: int) -> int:
    """Return how many samples with so many frames the episodes have."""
    return int(np.maximum(lengths - (history - 1), 0).sum())


def _lowest_error(train: Samples, validation: Samples, rows: Int64[Tensor, " row"]) -> float:
    """Return the mean squared error on some of the validation samples under the penalty that has the lowest."""
    inputs = train.x.shape[1]
    generator = named_generator(0, "history/layer")
    layer = torch.randn(inputs + 1, UNITS, generator=generator, dtype=torch.float64)
    layer[:inputs] /= inputs**0.5
    xx, xy = torch.zeros((), dtype=torch.float64), torch.zeros((), dtype=torch.float64)
    for first in range(0, len(train), BLOCK_ROWS):
        block = slice(first, first + BLOCK_ROWS)
        x = _expanded(train, block, layer)
        xx, xy = xx + x.T @ x / len(train), xy + x.T @ train.y[block].double() / len(train)
    errors = torch.zeros(len(PENALTIES), dtype=torch.float64)
    of_layer = torch.arange(len(xx)) > inputs
    weights = [torch.linalg.solve(xx + torch.where(of_layer, each, LINEAR_PENALTY).diag(), xy) for each in PENALTIES]
    for part in torch.split(rows, BLOCK_ROWS):
        x, y = _expanded(validation, part, layer), validation.y[part]
        errors += torch.stack([(x @ weight - y).square().mean() for weight in weights]) * len(part) / len(rows)
    return float(errors.min())


def _expanded(
    samples: Samples, rows: Int64[Tensor, " row"] | slice, layer: Float64[Tensor, "input unit"]
) -> Float64[Tensor, "row column"]:
    """Return inputs, a one, and what the units of a layer make of them."""
    x = samples.x[rows].double()
    given = torch.cat([x, torch.ones(len(x), 1, dtype=torch.float64)], dim=1)
    return torch.cat([given, torch.tanh(given @ layer)], dim=1)
