"""Errors of two models from several seeds, and the words for them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median

from addressed_dynamics.evaluation.transitions.records import CandidateResult
from addressed_dynamics.reporting.common.comparison import Relation, relate
from addressed_dynamics.reporting.common.numbers import listed, scientific

MOST_NUMBERS = 3
"""Errors of which a sentence has the numbers; of more it says which are lower."""


_IN_ROLLOUTS = " in rollouts"


_WORDS = {"lower": "lower", "higher": "higher", "unclear": "no clear difference"}


@dataclass(frozen=True)
class Comparison:
    """One error of the delivered kind of model beside that of another."""

    quantity: str
    """Which error, as part of a sentence."""
    own: tuple[float, ...]
    """Ours, from each seed."""
    other: tuple[float, ...]
    """The other's, from each of its seeds."""

    @property
    def relation(self) -> Relation:
        """Whether ours is lower."""
        return relate(self.own, self.other)

    def __str__(self) -> str:
        return f"{self.quantity} {scientific(median(self.own))} against {scientific(median(self.other))}"


def compare(own: Sequence[CandidateResult], other: Sequence[CandidateResult]) -> tuple[Comparison, ...]:
    """Compare two models, each from some seeds: mean one-step error, and the median error of rollouts by dimension."""
    errors = {"one step ahead": [[each.one_step.scaled.mean for each in group] for group in (own, other)]}
    first = own[0].rollouts
    for name in first.all.mse if first else ():
        errors[name + _IN_ROLLOUTS] = [_rollout_medians(group, name) for group in (own, other)]
    return tuple(
        Comparison(quantity, tuple(ours), tuple(theirs))
        for quantity, (ours, theirs) in errors.items()
        if ours and theirs
    )


def beats(comparisons: Sequence[Comparison]) -> str:
    """Return what the comparisons add up to: `beats`, `does not beat`, or what between them is true."""
    relations = {comparison.relation for comparison in comparisons}
    if relations == {"lower"}:
        return "beats"
    if "lower" not in relations:
        return "does not beat"
    lower = [comparison.quantity for comparison in comparisons if comparison.relation == "lower"]
    which = listed(lower) if len(lower) <= MOST_NUMBERS else f"in {len(lower)} of {len(comparisons)} errors"
    return f"is only in part ({which}) better than"


def details(comparisons: Sequence[Comparison]) -> str:
    """Return the errors with what is lower; of many errors only what is lower."""
    if len(comparisons) > MOST_NUMBERS:
        return _grouped(comparisons)
    relations = {comparison.relation for comparison in comparisons}
    if len(relations) > 1:
        return "; ".join(f"{comparison} ({_WORDS[comparison.relation]})" for comparison in comparisons)
    common = {"lower": "", "higher": ", each of them higher", "unclear": ", none of them a clear difference"}
    if len(comparisons) == 1:
        common |= {"higher": ", which is higher", "unclear": ", no clear difference"}
    return f"{'; '.join(map(str, comparisons))}{common[relations.pop()]}"


def spread_over_seeds(comparison: Comparison) -> str:
    """Return one comparison with the spread of both sides and what follows."""
    ours, theirs = (_spread(errors) for errors in (comparison.own, comparison.other))
    return f"{comparison.quantity} {ours} against {theirs}: {_WORDS[comparison.relation]}"


def _spread(errors: Sequence[float]) -> str:
    if len(errors) == 1:
        return f"{scientific(errors[0])} (one seed)"
    lowest, highest = scientific(min(errors)), scientific(max(errors))
    return f"{scientific(median(errors))} ({len(errors)} seeds: {lowest} to {highest})"


def _grouped(comparisons: Sequence[Comparison]) -> str:
    rollouts = [comparison for comparison in comparisons if comparison.quantity.endswith(_IN_ROLLOUTS)]
    parts = [
        f"{comparison} ({_WORDS[comparison.relation]})" for comparison in comparisons if comparison not in rollouts
    ]
    groups: dict[Relation, list[str]] = {"lower": [], "higher": [], "unclear": []}
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
