"""Mean, spread and range of columns, one shard at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64, Shaped

from addressed_dynamics.transitions import ContinuousAction, Transitions


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


def column_names(transitions: Transitions) -> list[str]:
    """Return the names of the columns that `column_values` stacks."""
    spec = transitions.spec
    names = [f"{prefix}.{name}" for prefix in ("observation", "change") for name in spec.observation_names]
    if isinstance(spec.action, ContinuousAction):
        names += [f"action.{dimension.name}" for dimension in spec.action.dimensions]
    return [*names, "reward"]


def column_values(transitions: Transitions) -> Float64[np.ndarray, "step column"]:
    """Stack the observation, its change in the step, a continuous action and the reward, in float64."""
    observation = transitions.observation.astype(np.float64)
    columns = [observation, transitions.next_observation - observation]
    if isinstance(transitions.spec.action, ContinuousAction):
        columns.append(transitions.action.astype(np.float64))
    return np.concatenate([*columns, transitions.reward[:, None].astype(np.float64)], axis=1)


def moments_to_json(names: list[str], moments: Moments) -> dict[str, Any]:
    """Return mean, std, min and max by column name; `moments` must have rows."""
    values = zip(moments.mean, moments.std, moments.minimum, moments.maximum, strict=True)
    return {
        name: {"mean": float(mean), "std": float(std), "min": float(low), "max": float(high)}
        for name, (mean, std, low, high) in zip(names, values, strict=True)
    }
