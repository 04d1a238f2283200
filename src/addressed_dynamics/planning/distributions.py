"""From what the cross-entropy method draws plans: an action each block, of a finite set or from a box."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from jaxtyping import Float64, Int64

from addressed_dynamics.planning.bounds import Box

LEAST_DEVIATION = 1e-3
"""Least standard deviation of an action, as a share of its range."""
FIRST_DEVIATION = 0.25
"""Standard deviation of an action of which nothing is known, as a share of its range."""
OPEN = 0.5
"""How far a distribution returns, one block later, to that of which nothing is known: plans may change their mind."""


class Distribution(Protocol):
    """Where plans come from; a plan is one action a block."""

    def draw(self, number: int, generator: np.random.Generator) -> np.ndarray:
        """Return plans, (number, block) integers or (number, block, d_act)."""

    def likeliest(self) -> np.ndarray:
        """Return the plan in the middle of the distribution, (block,) or (block, d_act)."""

    def fitted(self, elites: np.ndarray, smoothing: float) -> Distribution:
        """Return the distribution that moves to the elites, by a share of the way."""

    def shifted(self) -> Distribution:
        """Return where to begin one block later."""


@dataclass(frozen=True)
class Categorical:
    """Independent actions of a finite set, one a block (de Boer et al. 2005)."""

    probabilities: Float64[np.ndarray, "block action"]
    """Probability of each action in each block."""

    @staticmethod
    def uniform(blocks: int, actions: int) -> Categorical:
        """Return the distribution of which nothing is known."""
        return Categorical(np.full((blocks, actions), 1.0 / actions))

    def draw(self, number: int, generator: np.random.Generator) -> Int64[np.ndarray, "plan block"]:
        """Return plans."""
        ends = self.probabilities.cumsum(axis=1)[:, :-1]
        chosen: Int64[np.ndarray, "plan block"] = (
            (generator.random((number, len(ends), 1)) >= ends).sum(axis=2).astype(np.int64)
        )
        return chosen

    def likeliest(self) -> Int64[np.ndarray, " block"]:
        """Return the likeliest action of each block; the first of several."""
        likeliest: Int64[np.ndarray, " block"] = self.probabilities.argmax(axis=1)
        return likeliest

    def fitted(self, elites: np.ndarray, smoothing: float) -> Categorical:
        """Move to the shares that actions have among the elites."""
        shares = np.eye(self.probabilities.shape[1])[elites].mean(axis=0)
        return Categorical((1.0 - smoothing) * self.probabilities + smoothing * shares)

    def shifted(self) -> Categorical:
        """Drop the first block, add an open one, and open the others again."""
        open_ = Categorical.uniform(*self.probabilities.shape).probabilities
        kept = np.concatenate([self.probabilities[1:], open_[:1]])
        return Categorical((1.0 - OPEN) * kept + OPEN * open_)


@dataclass(frozen=True)
class Gaussian:
    """Independent components from a box, normally distributed and clipped to it (Rubinstein & Kroese 2004)."""

    mean: Float64[np.ndarray, "block action"]
    """In the actions' units."""
    deviation: Float64[np.ndarray, "block action"]
    """Standard deviations, in the actions' units."""
    box: Box
    """Where actions lie."""

    @staticmethod
    def middle(blocks: int, box: Box) -> Gaussian:
        """Return the distribution of which nothing is known: around the middle of the box."""
        middle, spread = (box.low + box.high) / 2, FIRST_DEVIATION * (box.high - box.low)
        return Gaussian(np.tile(middle, (blocks, 1)), np.tile(spread, (blocks, 1)), box)

    def draw(self, number: int, generator: np.random.Generator) -> Float64[np.ndarray, "plan block action"]:
        """Return plans."""
        noise = generator.standard_normal((number, *self.mean.shape))
        drawn: Float64[np.ndarray, "plan block action"] = np.clip(self.mean + self.deviation * noise, *self.box)
        return drawn

    def likeliest(self) -> Float64[np.ndarray, "block action"]:
        """Return the mean of each block."""
        return self.mean

    def fitted(self, elites: np.ndarray, smoothing: float) -> Gaussian:
        """Move to mean and standard deviation of the elites."""
        mean = (1.0 - smoothing) * self.mean + smoothing * elites.mean(axis=0)
        deviation = (1.0 - smoothing) * self.deviation + smoothing * elites.std(axis=0)
        least = LEAST_DEVIATION * (self.box.high - self.box.low)
        return Gaussian(mean, np.maximum(deviation, least), self.box)

    def shifted(self) -> Gaussian:
        """Drop the first block, repeat the mean of the last, and spread all of them again."""
        spread = Gaussian.middle(len(self.mean), self.box).deviation
        kept = np.concatenate([self.deviation[1:], spread[:1]])
        return Gaussian(following(self.mean), (1.0 - OPEN) * kept + OPEN * spread, self.box)


def following(plan: np.ndarray) -> np.ndarray:
    """Return a plan one block later: without its first block, and with its last one twice."""
    return np.concatenate([plan[1:], plan[-1:]])
