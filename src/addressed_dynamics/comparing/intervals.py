"""Errors of a model in multiples of another version's, with the interval that other test episodes would leave.

Where both were judged on the same episodes, the same ones are drawn for both, as in `evaluation.common.bootstrap`; else
each draws its own, and the interval is wider.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int64

from addressed_dynamics.comparing.versions import EpisodeErrors
from addressed_dynamics.evaluation.common.bootstrap import (
    FEWEST_EPISODES,
    SEED,
    Ratio,
    Weights,
    draws,
    ratio_in_draws,
    weighted_medians,
)
from addressed_dynamics.evaluation.transitions.records import NOTHING

Statistic = Callable[[Weights], Float64[np.ndarray, " draw"]]


@dataclass(frozen=True)
class Beside:
    """Errors of a version and of another one."""

    first: float
    second: float
    ratio: Ratio | None
    """The second in multiples of the first; None where there are too few episodes, or an error is zero."""
    paired: bool
    """Whether both are of the same test episodes."""


@dataclass(frozen=True)
class _Side:
    """A statistic of one version under draws of episodes."""

    episode: Int64[np.ndarray, " part"]
    statistic: Statistic

    def value(self) -> float:
        """On the episodes as they are."""
        return float(self.statistic(np.ones((1, len(self.episode)), dtype=np.int64))[0])


def one_step_beside(
    first: EpisodeErrors, one: str, second: EpisodeErrors, other: str, *, same_data: bool
) -> Beside | None:
    """Return the mean one-step losses of two models, on the test episodes that both versions have.

    Args:
        first: of the first version.
        one: the model of it.
        second: of the second version.
        other: the model of it.
        same_data: whether both have the same tables.
    """
    if one not in first.one_step or other not in second.one_step:
        return None
    paired = same_data and _share(first.episode, second.episode)
    both = np.intersect1d(first.episode, second.episode) if paired else None
    return _beside(_means(first, one, both), _means(second, other, both), paired=paired)


def rollouts_beside(
    first: EpisodeErrors,
    one: str,
    second: EpisodeErrors,
    other: str,
    weights: Float64[np.ndarray, " observation"],
    *,
    same_data: bool,
) -> Beside | None:
    """Return the medians over rollouts of two models' mean squared errors, weighted over dimensions.

    The rollouts are paired where the data are the same and nothing changing has the same errors in both: then they
    begin and end alike.
    """
    if one not in first.rollouts or other not in second.rollouts:
        return None
    if not len(first.rollout_episode) or not len(second.rollout_episode):
        return None
    paired = same_data and _same_rollouts(first, second)
    sides = (_medians(errors, name, weights) for errors, name in ((first, one), (second, other)))
    return _beside(*sides, paired=paired)


def _means(errors: EpisodeErrors, name: str, among: Int64[np.ndarray, " episode"] | None) -> _Side:
    kept = np.ones(len(errors.episode), dtype=bool) if among is None else np.isin(errors.episode, among)
    losses, samples = errors.one_step[name][kept], errors.samples[kept]
    return _Side(errors.episode[kept], lambda drawn: (drawn @ losses) / np.maximum(drawn @ samples, 1))


def _medians(errors: EpisodeErrors, name: str, weights: Float64[np.ndarray, " observation"]) -> _Side:
    values = errors.rollouts[name] @ weights
    return _Side(errors.rollout_episode, lambda drawn: weighted_medians(values, drawn))


def _beside(first: _Side, second: _Side, *, paired: bool) -> Beside:
    values = first.value(), second.value()
    return Beside(*values, _ratio(first, second, paired=paired), paired)


def _ratio(first: _Side, second: _Side, *, paired: bool) -> Ratio | None:
    sides = first, second
    if min(len(np.unique(side.episode)) for side in sides) < FEWEST_EPISODES:
        return None
    # Paired, both draw the same episodes, for their numbers and so their places are the same.
    seeds = (SEED, SEED) if paired else (SEED, SEED + 1)
    one, other = (side.statistic(draws(side.episode, seed)) for side, seed in zip(sides, seeds, strict=True))
    return ratio_in_draws(other, one)


def _share(one: Int64[np.ndarray, " episode"], other: Int64[np.ndarray, " episode"]) -> bool:
    return len(np.intersect1d(one, other)) >= FEWEST_EPISODES


def _same_rollouts(first: EpisodeErrors, second: EpisodeErrors) -> bool:
    if not np.array_equal(first.rollout_episode, second.rollout_episode):
        return False
    # The errors of what predicts that nothing changes depend on the test data alone.
    still = [next((name for name in each.rollouts if name.startswith(NOTHING)), None) for each in (first, second)]
    if still[0] is None or still[1] is None:
        return False
    return bool(np.allclose(first.rollouts[still[0]], second.rollouts[still[1]], rtol=1e-5, atol=0.0))
