"""Comparisons of two models of motion from some seeds, and how far one step ahead tells of the closed loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import median

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.evaluation.motion.records import Candidate, MotionEvaluation
from addressed_dynamics.reporting.common.comparison import Comparison, Relation, relate
from addressed_dynamics.reporting.common.numbers import listed, significant

SCORE_MARGIN = 0.02
"""A closed-loop score counts as higher than another if it is so by more than this, from every seed."""

_WORDS = {"better": "better", "worse": "worse", "unclear": "no clear difference"}


def compare(own: Sequence[Candidate], other: Sequence[Candidate]) -> tuple[Comparison, ...]:
    """Compare two models: errors on held-out clips, score in the closed loop, and how fast feet slide there.

    The last is left out if a model never says that a foot touches the ground.
    """
    found = []
    for quantity, of, judged in (
        ("raw MAE", raw_error, relate),
        ("normalised MAE", normalised_error, relate),
        ("closed-loop score", score_of, _of_scores),
        ("foot skate", skate_of, relate),
    ):
        ours, theirs = _known(own, of), _known(other, of)
        if ours and theirs:
            found.append(Comparison(quantity, ours, theirs, judged(ours, theirs)))
    return tuple(found)


def details(comparisons: Sequence[Comparison]) -> str:
    """Return all figures, each with what is better."""
    return "; ".join(f"{each.medians(significant)} ({_WORDS[each.relation]})" for each in comparisons)


def raw_error(candidate: Candidate) -> float:
    """Return the mean absolute error on held-out clips, whatever the units."""
    return candidate.test.raw


def normalised_error(candidate: Candidate) -> float:
    """Return the same in units of deviations."""
    return candidate.test.normalised


def score_of(candidate: Candidate) -> float:
    """Return the score in the closed loop under the test script."""
    return candidate.closed_loop.score


def skate_of(candidate: Candidate) -> float | None:
    """Return how fast feet slide that the model says touch the ground, in cm/s; None if it never says so."""
    return candidate.closed_loop.run.all.skate_speed


def outcome(comparisons: Sequence[Comparison], title: str) -> str:
    """Return what comparisons with the model `title` add up to, as the rest of a sentence."""
    better, worse = (
        [each.quantity for each in comparisons if each.relation == relation] for relation in ("better", "worse")
    )
    if not better and not worse:
        return f"does not clearly differ from {title}"
    if len(better) == len(comparisons):
        return f"beats {title} in {_summed_up(better)}"
    if len(worse) == len(comparisons):
        return f"is worse than {title} in {_summed_up(worse)}"
    if not better:
        return f"does not beat {title}, which is better in {_summed_up(worse)}"
    rest = f", but worse in {_summed_up(worse)}" if worse else ""
    return f"is better than {title} in {_summed_up(better)}{rest}"


def middle(group: Sequence[Candidate], of: Callable[[Candidate], float | None]) -> float | None:
    """Return the median over seeds; None if a seed has no such figure, or there are no seeds."""
    values = _known(group, of)
    return median(values) if values else None


def rank_correlation(first: Sequence[float], second: Sequence[float]) -> float | None:
    """Return Spearman's rank correlation, with mean ranks for equal values; None if a side does not vary."""
    ranks = [_ranks(np.array(values, np.float64)) for values in (first, second)]
    a, b = (each - each.mean() for each in ranks)
    norm = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / norm if norm else None


def ranking(evaluation: MotionEvaluation, names: Sequence[str]) -> float | None:
    """Return the rank correlation of raw error one step ahead and score of some models: -1 where errors tell all."""
    groups = [evaluation.models[name] for name in names]
    if len(groups) < 3:
        return None
    return rank_correlation(*([median(map(of, group)) for group in groups] for of in (raw_error, score_of)))


def _summed_up(quantities: list[str]) -> str:
    """List quantities, with both kinds of error as one."""
    if {"raw MAE", "normalised MAE"} <= set(quantities):
        quantities = ["MAE", *quantities[2:]]
    return listed(quantities)


def _known(group: Sequence[Candidate], of: Callable[[Candidate], float | None]) -> tuple[float, ...]:
    """Return a figure from every seed; nothing if one of them has none."""
    values = [of(each) for each in group]
    known = tuple(value for value in values if value is not None)
    return known if len(known) == len(values) else ()


def _ranks(values: Float64[np.ndarray, " value"]) -> Float64[np.ndarray, " value"]:
    below = (values[:, None] > values[None, :]).sum(axis=1)
    equal = (values[:, None] == values[None, :]).sum(axis=1)
    ranks: Float64[np.ndarray, " value"] = below + (equal - 1) / 2.0
    return ranks


def _of_scores(own: Sequence[float], other: Sequence[float]) -> Relation:
    if min(own) > max(other) + SCORE_MARGIN:
        return "better"
    return "worse" if min(other) > max(own) + SCORE_MARGIN else "unclear"
