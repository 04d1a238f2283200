"""How far the ratio of two models' errors hangs on which episodes were held out: a paired bootstrap over episodes.

Steps of an episode are alike, so the episode is what is drawn: as many as there are, with repetition, the same ones for
both models.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

COVERAGE = 0.95
"""Share of the draws that lie in an interval."""
DRAWS = 2_000
COUNTS = 2**21
"""Numbers of how often an episode is drawn that are looked at together."""
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
    return ratios_of_sums({"": errors}, others, episode)[""]


def ratios_of_sums(
    errors: Mapping[str, Errors], others: Errors, episode: Int64[np.ndarray, " part"]
) -> dict[str, Ratio | None]:
    """Return `ratio_of_sums` of several models beside the same one, which look at each draw together."""
    if len(np.unique(episode)) < FEWEST_EPISODES:
        return dict.fromkeys(errors)
    sums = [
        (weights @ others, {name: weights @ values for name, values in errors.items()}) for weights in _blocks(episode)
    ]
    beside = np.concatenate([each for each, _ in sums])
    return {name: ratio_in_draws(np.concatenate([each[name] for _, each in sums]), beside) for name in errors}


def ratio_of_medians(errors: Errors, others: Errors, episode: Int64[np.ndarray, " part"]) -> Ratio | None:
    """Return the ratio of the medians of two models' errors over the parts, as `ratio_of_sums` does.

    A median jumps from one part to the next, and those of a pair are of different parts: the interval is rather too
    wide than too narrow.
    """
    if len(np.unique(episode)) < FEWEST_EPISODES:
        return None
    weights = draws(episode)
    return ratio_in_draws(weighted_medians(errors, weights), weighted_medians(others, weights))


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
    return np.concatenate([*_blocks(episode, seed)])


def _blocks(episode: Int64[np.ndarray, " part"], seed: int = SEED) -> Iterator[Weights]:
    """Yield what `draws` returns, some draws at a time: with thousands of episodes all would be gigabytes."""
    found, place = np.unique(episode, return_inverse=True)
    generator, shares = np.random.default_rng(seed), np.full(len(found), 1.0 / len(found))
    # Rows are multiplied four at a time, and those of a block should be those of all.
    rows = max(4, COUNTS // max(len(found), len(place)) // 4 * 4)
    for first in range(0, 1 + DRAWS, rows):
        number = min(rows, 1 + DRAWS - first)
        drawn = generator.multinomial(len(found), shares, size=number - (first == 0))
        yield (drawn if first else np.concatenate([np.ones((1, len(found)), dtype=np.int64), drawn]))[:, place]


def ratio_in_draws(errors: Float64[np.ndarray, " draw"], others: Float64[np.ndarray, " draw"]) -> Ratio | None:
    """Return the ratio of a statistic of two models under `draws`; None if the other's is zero in one of them."""
    if not (others > 0).all():
        return None
    ratios = errors / others
    tail = (1.0 - COVERAGE) / 2.0
    low, high = np.quantile(ratios[1:], [tail, 1.0 - tail])
    return Ratio(float(ratios[0]), float(low), float(high))
