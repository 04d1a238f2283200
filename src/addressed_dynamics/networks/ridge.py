"""Ridge regression from inputs to outputs: closed form, in float64, in one pass over the rows."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.features.common.samples import Windows

PENALTIES = tuple(10.0**exponent for exponent in range(-6, 2))
"""Penalties that are tried."""
SMALLEST_DEVIATION = 1e-6
"""An input that deviates less is constant and gets no weight."""
CHUNK_ROWS = 8192

Rows = Float[np.ndarray, "row column"] | Float[Tensor, "row column"] | Windows
Chunks = Iterable[tuple[Float[np.ndarray, "row input"], Float[np.ndarray, "row output"]]]


@dataclass(frozen=True)
class Ridge:
    """A linear map, as a predictor of motion: called with inputs and phases, of which it ignores the latter."""

    weight: Float[Tensor, "input output"]
    bias: Float[Tensor, " output"]
    penalty: float
    """Of the squared weights of inputs in units of their deviation, beside the mean squared error."""

    def __call__(self, x: Float[Tensor, "row input"], phase: Float[Tensor, " row"]) -> Float[Tensor, "row output"]:  # noqa: ARG002 - a predictor is given it
        """Return the outputs."""
        return x @ self.weight + self.bias


@dataclass(frozen=True)
class Moments:
    """Means and second moments of inputs and outputs: all that ridge regression needs of the rows."""

    rows: int
    x_mean: Float64[np.ndarray, " input"]
    y_mean: Float64[np.ndarray, " output"]
    xx: Float64[np.ndarray, "input input"]
    """Covariance of the inputs."""
    xy: Float64[np.ndarray, "input output"]
    """Covariance of inputs and outputs."""


def moments(chunks: Chunks) -> Moments:
    """Return the moments of rows that come in chunks.

    Raises:
        TrainingError: there are no rows.
    """
    rows, sums = 0, (np.zeros(()),) * 4
    x_origin = y_origin = np.zeros(())
    for x_rows, y_rows in chunks:
        if not len(x_rows):
            continue
        x, y = np.asarray(x_rows, np.float64), np.asarray(y_rows, np.float64)
        if not rows:
            # Seen from near their mean: squares of large numbers would not leave digits for small deviations.
            x_origin, y_origin = x.mean(axis=0), y.mean(axis=0)
        x, y = x - x_origin, y - y_origin
        rows += len(x)
        own = (x.sum(axis=0), y.sum(axis=0), x.T @ x, x.T @ y)
        sums = tuple(total + more for total, more in zip(sums, own, strict=True))
    if not rows:
        message = "ridge regression needs at least one row"
        raise TrainingError(message)
    x_sum, y_sum, xx, xy = sums
    x_mean, y_mean = x_sum / rows, y_sum / rows
    return Moments(
        rows=rows,
        x_mean=x_origin + x_mean,
        y_mean=y_origin + y_mean,
        xx=xx / rows - np.outer(x_mean, x_mean),
        xy=xy / rows - np.outer(x_mean, y_mean),
    )


def solve(of: Moments, penalties: Sequence[float]) -> Iterator[Ridge]:
    """Yield the best linear map under each penalty: one decomposition serves all.

    Minimises, for inputs divided by their deviation, the mean squared error plus the penalty times the squared weights.
    """
    deviation = np.sqrt(np.maximum(np.diagonal(of.xx), 0.0))
    scale = np.where(deviation > SMALLEST_DEVIATION, 1.0 / np.maximum(deviation, SMALLEST_DEVIATION), 0.0)
    eigenvalues, vectors = np.linalg.eigh(scale[:, None] * of.xx * scale)
    turned = vectors.T @ (scale[:, None] * of.xy)
    for penalty in penalties:
        weight = scale[:, None] * (vectors @ (turned / (np.maximum(eigenvalues, 0.0) + penalty)[:, None]))
        bias = of.y_mean - of.x_mean @ weight
        yield Ridge(torch.from_numpy(weight).float(), torch.from_numpy(bias).float(), penalty)


def fit_ridge(
    train: tuple[Rows, Rows],
    validation: tuple[Rows, Rows],
    penalties: Sequence[float] = PENALTIES,
) -> Ridge:
    """Return the linear map with the penalty that has the lowest mean absolute error on the validation rows.

    Raises:
        TrainingError: there are no rows to train on or to choose by.
    """
    if not len(validation[0]):
        message = "ridge regression chooses its penalty on validation rows, but there are none"
        raise TrainingError(message)
    candidates = linear_maps(*train, penalties)
    errors = np.zeros(len(candidates))
    for x, y in _chunks(*validation):
        given, true = torch.from_numpy(x).float(), torch.from_numpy(y).float()
        errors += [float((given @ each.weight + each.bias - true).abs().double().sum()) for each in candidates]
    return candidates[int(errors.argmin())]


def linear_maps(x: Rows, y: Rows, penalties: Sequence[float] = PENALTIES) -> list[Ridge]:
    """Return the best linear map of some rows under each penalty.

    Raises:
        TrainingError: there are no rows.
    """
    return list(solve(moments(_chunks(x, y)), penalties))


def _chunks(x: Rows, y: Rows) -> Chunks:
    blocks = (slice(first, first + CHUNK_ROWS) for first in range(0, len(x), CHUNK_ROWS))
    return ((np.asarray(x[block]), np.asarray(y[block])) for block in blocks)
