"""How far the ratio of two models' errors hangs on which episodes were held out: a paired bootstrap over episodes.

Steps of an episode are alike, so the episode is what is drawn: as many as there are, with repetition, the same ones for
both models.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Float64, Int64

COVERAGE = 0.95
"""Share of the draws that lie in an interval."""
DRAWS = 2_000
SEED = 0
"""Where the draws come from: the same for all pairs, so that what is compared is compared on the same episodes."""
FEWEST_EPISODES = 5
"""With fewer episodes there is no interval: a handful of draws would look surer than they are."""
FEWEST_ROLLOUTS = 20
"""With fewer rollouts there are no percentiles but the median, and no model is said to be better than another."""

Errors = Float64[np.ndarray, " part"]
"""Errors of a model in parts of episodes: one for each episode, or for each of its rollouts."""
Weights = Int64[np.ndarray, "draw part"]
"""How often each part is there in each draw."""


@dataclass(frozen=True)
class Ratio:
    """An error in multiples of another, with the interval that holds most of the draws."""

    value: float
    """On the episodes as they are."""
    low: float
    high: float


def ratio_of_sums(errors: Errors, others: Errors, episode: Int64[np.ndarray, " part"]) -> Ratio | None:
    """Return the ratio of two sums of errors, and so of the means over the same steps.

    Args:
        errors: of one model, not negative.
        others: of the model that is compared with, in the same parts.
        episode: which episode each part is of.

    Returns:
        None with fewer than `FEWEST_EPISODES` episodes, or if the other's error is zero in a draw.
    """
    return _ratio(errors, others, episode, lambda values, weights: weights @ values)


def ratio_of_medians(errors: Errors, others: Errors, episode: Int64[np.ndarray, " part"]) -> Ratio | None:
    """Return the ratio of the medians of two models' errors over the parts, as `ratio_of_sums` does.

    A median jumps from one part to the next, and those of a pair are of different parts: the interval is rather too
    wide than too narrow.
    """
    return _ratio(errors, others, episode, weighted_medians)


def weighted_medians(values: Float64[np.ndarray, " part"], weights: Weights) -> Float64[np.ndarray, " draw"]:
    """Return the median of the values in each draw, in which each value is there so many times."""
    order = np.argsort(values, kind="stable")
    ordered, upto = values[order], np.cumsum(weights[:, order], axis=1)
    number = upto[:, -1:]
    below, above = ((upto > place).argmax(axis=1) for place in ((number - 1) // 2, number // 2))
    medians: Float64[np.ndarray, " draw"] = (ordered[below] + ordered[above]) / 2.0
    return medians


def draws(episode: Int64[np.ndarray, " part"], seed: int = SEED) -> Weights:
    """Return how often each part is there: all of them once, as they are, and then in each draw of episodes.

    Args:
        episode: which episode each part is of.
        seed: where the draws come from; the same one draws the same of the same number of episodes.
    """
    found, place = np.unique(episode, return_inverse=True)
    as_they_are = np.ones((1, len(found)), dtype=np.int64)
    weights: Weights = np.concatenate([as_they_are, _drawn(len(found), seed)])[:, place]
    return weights


def ratio_in_draws(errors: Float64[np.ndarray, " draw"], others: Float64[np.ndarray, " draw"]) -> Ratio | None:
    """Return the ratio of a statistic of two models under `draws`; None if the other's is zero in one of them."""
    if not (others > 0).all():
        return None
    ratios = errors / others
    tail = (1.0 - COVERAGE) / 2.0
    low, high = np.quantile(ratios[1:], [tail, 1.0 - tail])
    return Ratio(float(ratios[0]), float(low), float(high))


def _ratio(
    errors: Errors,
    others: Errors,
    episode: Int64[np.ndarray, " part"],
    statistic: Callable[[Errors, Weights], Float64[np.ndarray, " draw"]],
) -> Ratio | None:
    if len(np.unique(episode)) < FEWEST_EPISODES:
        return None
    weights = draws(episode)
    return ratio_in_draws(statistic(errors, weights), statistic(others, weights))


@lru_cache(maxsize=4)
def _drawn(episodes: int, seed: int) -> Int64[np.ndarray, "draw episode"]:
    """Return how often each episode is drawn, in their order by number."""
    generator = np.random.default_rng(seed)
    return generator.multinomial(episodes, np.full(episodes, 1.0 / episodes), size=DRAWS)
