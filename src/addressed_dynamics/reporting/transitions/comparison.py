"""Errors of two models from several seeds, and the words for them."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf
from statistics import median

from addressed_dynamics.evaluation.transitions.records import CandidateResult, RatioResult
from addressed_dynamics.reporting.common.comparison import UNKNOWN, Comparison, Interval, Relation, relate
from addressed_dynamics.reporting.common.numbers import listed, scientific, significant

MOST_NUMBERS = 3
"""Errors of which a sentence has the numbers; of more it says which are lower."""


_IN_ROLLOUTS = " in rollouts"


_WORDS = {"better": "lower", "worse": "higher", "unclear": "no clear difference"}


def compare(own: Sequence[CandidateResult], other: Sequence[CandidateResult]) -> tuple[Comparison, ...]:
    """Compare two models, each from some seeds: mean one-step error, and the median error of rollouts by dimension.

    The first of ours is of the first seed, which the intervals of the other are held against.
    """
    beside = [each.beside_ensemble for each in other if each.beside_ensemble is not None]
    errors = {"one step ahead": [[each.one_step.scaled.mean for each in group] for group in (own, other)]}
    ratios = {"one step ahead": [each.one_step for each in beside]}
    first = own[0].rollouts
    for name in first.all.mse if first else ():
        errors[name + _IN_ROLLOUTS] = [_rollout_medians(group, name) for group in (own, other)]
        ratios[name + _IN_ROLLOUTS] = [each.dimensions.get(name) for each in beside]
    return tuple(
        _comparison(quantity, ours, theirs, ratios[quantity])
        for quantity, (ours, theirs) in errors.items()
        if ours and theirs
    )


def _comparison(
    quantity: str, own: Sequence[float], other: Sequence[float], ratios: Sequence[RatioResult | None]
) -> Comparison:
    intervals = [UNKNOWN if ratio is None else Interval(ratio.low, ratio.high) for ratio in ratios]
    widest = Interval(min(each.low for each in intervals), max(each.high for each in intervals)) if intervals else None
    return Comparison(quantity, tuple(own), tuple(other), relate(own, other, intervals), widest)


def beats(comparisons: Sequence[Comparison]) -> str:
    """Return what the comparisons add up to: `beats`, `does not beat`, or what between them is true."""
    relations = {comparison.relation for comparison in comparisons}
    if relations == {"better"}:
        return "beats"
    if "better" not in relations:
        return "does not beat"
    lower = [comparison.quantity for comparison in comparisons if comparison.relation == "better"]
    which = listed(lower) if len(lower) <= MOST_NUMBERS else f"in {len(lower)} of {len(comparisons)} errors"
    return f"is only in part ({which}) better than"


def details(comparisons: Sequence[Comparison]) -> str:
    """Return the errors with what is lower; of many errors only what is lower."""
    if len(comparisons) > MOST_NUMBERS:
        return _grouped(comparisons)
    relations = {comparison.relation for comparison in comparisons}
    if len(relations) > 1:
        return "; ".join(
            f"{comparison.medians(scientific)} ({_WORDS[comparison.relation]})" for comparison in comparisons
        )
    common = {"better": "", "worse": ", each of them higher", "unclear": ", none of them a clear difference"}
    if len(comparisons) == 1:
        common |= {"worse": ", which is higher", "unclear": ", no clear difference"}
    return f"{'; '.join(each.medians(scientific) for each in comparisons)}{common[relations.pop()]}"


def spread_over_seeds(comparison: Comparison) -> str:
    """Return one comparison with the spread of both sides and what follows."""
    ours, theirs = (_spread(errors) for errors in (comparison.own, comparison.other))
    return f"{comparison.quantity} {ours} against {theirs}{_interval(comparison)}: {_WORDS[comparison.relation]}"


def _interval(comparison: Comparison) -> str:
    """Return how many times the ensemble's the other's error is, if that was asked for."""
    match comparison.interval:
        case None:
            return ""
        case Interval(low, high) if high < inf:
            return f", {significant(low)} to {significant(high)} times the ensemble's"
        case _:
            return ", of too few episodes to tell"


def _spread(errors: Sequence[float]) -> str:
    if len(errors) == 1:
        return f"{scientific(errors[0])} (one seed)"
    lowest, highest = scientific(min(errors)), scientific(max(errors))
    return f"{scientific(median(errors))} ({len(errors)} seeds: {lowest} to {highest})"


def _grouped(comparisons: Sequence[Comparison]) -> str:
    rollouts = [comparison for comparison in comparisons if comparison.quantity.endswith(_IN_ROLLOUTS)]
    parts = [
        f"{comparison.medians(scientific)} ({_WORDS[comparison.relation]})"
        for comparison in comparisons
        if comparison not in rollouts
    ]
    groups: dict[Relation, list[str]] = {"better": [], "worse": [], "unclear": []}
    for comparison in rollouts:
        groups[comparison.relation].append(comparison.quantity.removesuffix(_IN_ROLLOUTS))
    outcomes = [
        f"{_WORDS[relation]} for {listed(names) if len(names) < len(rollouts) else f'all {len(names)} dimensions'}"
        for relation, names in groups.items()
        if names
    ]
    return "; ".join([*parts, *([f"in rollouts {', '.join(outcomes)}"] if outcomes else [])])


def _rollout_medians(group: Sequence[CandidateResult], name: str) -> list[float]:
    rollouts = [candidate.rollouts for candidate in group if candidate.rollouts is not None]
    return [spread.median for each in rollouts if (spread := each.all.mse.get(name)) is not None]
