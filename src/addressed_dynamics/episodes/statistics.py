"""Mean, spread, range and quantiles of columns, one shard at a time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Shaped

from addressed_dynamics.episodes.transitions import ContinuousAction, Transitions


@dataclass(frozen=True)
class Moments:
    """Summary of the rows of some columns; summaries of parts merge into the summary of the whole."""

    count: int
    """Number of rows."""
    mean: Float64[np.ndarray, " column"]
    """Mean of each column; 0 without rows."""
    squares: Float64[np.ndarray, " column"]
    """Sum of squared differences from the mean."""
    minimum: Float64[np.ndarray, " column"]
    """Lowest value; infinity without rows."""
    maximum: Float64[np.ndarray, " column"]
    """Highest value; minus infinity without rows."""

    @staticmethod
    def of(values: Shaped[np.ndarray, "row column"]) -> Moments:
        """Summarise `values`, in float64."""
        exact = values.astype(np.float64)
        mean = exact.sum(axis=0) / max(len(exact), 1)
        return Moments(
            count=len(exact),
            mean=mean,
            squares=((exact - mean) ** 2).sum(axis=0),
            minimum=exact.min(axis=0, initial=np.inf),
            maximum=exact.max(axis=0, initial=-np.inf),
        )

    def merge(self, other: Moments) -> Moments:
        """Summarise the rows of both (Chan, Golub and LeVeque, 1979)."""
        count = self.count + other.count
        weight = other.count / max(count, 1)
        shift = other.mean - self.mean
        return Moments(
            count=count,
            mean=self.mean + shift * weight,
            squares=self.squares + other.squares + shift**2 * self.count * weight,
            minimum=np.minimum(self.minimum, other.minimum),
            maximum=np.maximum(self.maximum, other.maximum),
        )

    @property
    def std(self) -> Float64[np.ndarray, " column"]:
        """Standard deviation of each column, over the rows (not an estimate from a sample of them)."""
        deviation: Float64[np.ndarray, " column"] = np.sqrt(self.squares / max(self.count, 1))
        return deviation


SAMPLE_ROWS = 1024
"""Rows of each shard that its quantiles are taken from: enough to place a quartile within two hundredths."""


@dataclass(frozen=True)
class Sample:
    """Evenly spaced rows of some columns; samples of parts join into a sample of the whole."""

    values: Float64[np.ndarray, "row column"]
    """The rows."""
    weights: Float64[np.ndarray, " row"]
    """How many rows each of them stands for."""

    @staticmethod
    def of(values: Shaped[np.ndarray, "row column"]) -> Sample:
        """Take at most `SAMPLE_ROWS` rows of `values`."""
        size = min(len(values), SAMPLE_ROWS)
        rows = np.linspace(0, len(values) - 1, size).astype(np.int64) if size else np.empty(0, np.int64)
        return Sample(values[rows].astype(np.float64), np.full(size, len(values) / max(size, 1)))

    @staticmethod
    def join(parts: Sequence[Sample]) -> Sample:
        """Put the rows of all parts together, at least one: at once, because two by two copies the first ever again."""
        return Sample(
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )

    def quantiles(self, *shares: float) -> Float64[np.ndarray, "share column"]:
        """Return for each share the value that at least this share of the rows do not exceed; needs rows."""
        order = self.values.argsort(axis=0, kind="stable")
        below = self.weights[order].cumsum(axis=0) / self.weights.sum()
        ordered = np.take_along_axis(self.values, order, axis=0)
        # A little slack, because the sums of weights are not exact.
        rows = [(below < share - 1e-9).sum(axis=0).clip(max=len(order) - 1) for share in shares]
        return np.stack([ordered[row, np.arange(ordered.shape[1])] for row in rows])


def column_names(transitions: Transitions) -> list[str]:
    """Return the names of the columns that `column_values` stacks."""
    spec = transitions.spec
    names = [f"{prefix}.{name}" for prefix in ("observation", "change") for name in spec.observation_names]
    if isinstance(spec.action, ContinuousAction):
        names += [f"action.{dimension.name}" for dimension in spec.action.dimensions]
    names += [f"exogenous.{dimension.name}" for dimension in spec.exogenous]
    return [*names, "reward"]


def column_values(transitions: Transitions) -> Float64[np.ndarray, "step column"]:
    """Stack the observation, its change in the step, a continuous action, exogenous inputs and reward, in float64."""
    observation = transitions.observation.astype(np.float64)
    columns = [observation, transitions.next_observation - observation]
    if isinstance(transitions.spec.action, ContinuousAction):
        columns.append(transitions.action.astype(np.float64))
    columns.append(transitions.exogenous.astype(np.float64))
    return np.concatenate([*columns, transitions.reward[:, None].astype(np.float64)], axis=1)


def moments_to_json(names: list[str], moments: Moments) -> dict[str, Any]:
    """Return mean, std, min and max by column name; `moments` must have rows."""
    values = zip(moments.mean, moments.std, moments.minimum, moments.maximum, strict=True)
    return {
        name: {"mean": float(mean), "std": float(std), "min": float(low), "max": float(high)}
        for name, (mean, std, low, high) in zip(names, values, strict=True)
    }
