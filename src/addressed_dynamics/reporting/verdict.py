"""The verdict: from numbers to sentences that follow from them, favourable or not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import Literal

from addressed_dynamics.reporting.numbers import in_words, listed, percent, scientific, significant, times
from addressed_dynamics.reporting.records import AddressingResult, CandidateResult, Evaluation
from addressed_dynamics.reporting.targets import Target, separation

MARGIN = 1.1
"""One error counts as lower than another if it is so by more than this factor, from every seed."""

Relation = Literal["lower", "higher", "unclear"]


@dataclass(frozen=True)
class Comparison:
    """One error of the delivered kind of model beside that of another."""

    quantity: str
    """Which error, as part of a sentence."""
    own: float
    """Median over our seeds."""
    other: float
    """Median over the other's seeds."""
    relation: Relation
    """Whether ours is lower."""

    def __str__(self) -> str:
        return f"{self.quantity} {scientific(self.own)} against {scientific(self.other)}"


def relate(own: Sequence[float], other: Sequence[float]) -> Relation:
    """Say whether our errors (one per seed) are lower than another's: from every seed, and by more than `MARGIN`."""
    if max(own) * MARGIN < min(other):
        return "lower"
    return "higher" if max(other) * MARGIN < min(own) else "unclear"


def compare(own: Sequence[CandidateResult], other: Sequence[CandidateResult]) -> tuple[Comparison, ...]:
    """Compare two models, each from some seeds: mean one-step error, and the median error of rollouts by dimension."""
    errors = {"one step ahead": [[each.one_step.scaled.mean for each in group] for group in (own, other)]}
    first = own[0].rollouts
    for name in first.all.mse if first else ():
        errors[f"{name} in rollouts"] = [_rollout_medians(group, name) for group in (own, other)]
    return tuple(
        Comparison(quantity, median(ours), median(theirs), relate(ours, theirs))
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
    lower = listed([comparison.quantity for comparison in comparisons if comparison.relation == "lower"])
    return f"is only in part ({lower}) better than"


def verdict(evaluation: Evaluation, targets: Sequence[Target]) -> str:
    """Return the result in two sentences."""
    sentences = []
    if targets:
        met, unknown = (sum(target.met is state for target in targets) for state in (True, None))
        how_many = "all" if met == len(targets) else in_words(met)
        rest = f"; {in_words(unknown)} could not be measured" if unknown else ""
        sentences.append(
            f"The model reaches {how_many} of the {in_words(len(targets))} figures taken from the paper{rest}."
        )
    single = evaluation.baseline("total_parameters")
    if single:
        subject = "It" if targets else "The model"
        relation = beats(compare(evaluation.own_seeds, single))
        sentences.append(f"{subject} {relation} one network of the same size that was trained as long.")
    return " ".join(sentences) or "There is nothing to hold the model against."


def findings(evaluation: Evaluation, *, in_paper: bool = True) -> tuple[str, ...]:
    """Return the sentences that the verdict rests on.

    Args:
        evaluation: what was measured.
        in_paper: whether the paper reports on this experiment; if not, its claims are left alone.
    """
    own = evaluation.own_seeds
    sentences = [_one_step(evaluation), _specialisation(evaluation.table), _addressing(evaluation)]
    if evaluation.own.rollouts is not None:
        sentences.append(_rollouts(evaluation))
    wide_network = "the paper's one wide network" if in_paper else "one wide network"
    named = {"total_parameters": "one network with as many parameters", "wide": wide_network}
    for name, title in named.items():
        if other := evaluation.baseline(name):
            comparisons = compare(own, other)
            sentences.append(f"It {beats(comparisons)} {title}: {_details(comparisons)}.")
    if in_paper and (wide := evaluation.baseline("wide")):
        sentences.append(_wide_claim(own, wide))
    for name, title in {"unequal_bins": "without equal bins", "random_bins": "with fixed random bins"}.items():
        if other := evaluation.baseline(name):
            sentences.append(_bins(compare(own, other), title))
    if len(own) > 1:
        means = [candidate.one_step.scaled.mean for candidate in own]
        sentences.append(
            f"From {len(own)} seeds the mean one-step MSE lies between {scientific(min(means))} and "
            f"{scientific(max(means))}."
        )
    if len(evaluation.candidates) > len(own):
        sentences.append(
            "Comparisons are of medians over seeds; an error counts as lower if it is so from every seed and by more "
            f"than {percent(MARGIN - 1, 0)}."
        )
    return tuple(sentences)


def _one_step(evaluation: Evaluation) -> str:
    scaled = evaluation.own.one_step.scaled
    text = (
        f"One step ahead, on {evaluation.test.transitions:,} transitions of {evaluation.test.episodes:,} held-out "
        f"episodes, the mean {evaluation.loss.upper()} of states scaled to [0, 1] is {scientific(scaled.mean)} and "
        f"the median {scientific(scaled.median)}"
    )
    oracle = evaluation.candidates.get("ensemble/oracle")
    if oracle is None or not oracle.one_step.scaled.mean:
        return f"{text}."
    best = oracle.one_step.scaled.mean
    ratio = scaled.mean / best
    cost = f", {times(ratio)} lower" if ratio >= MARGIN else ", about the same"
    return f"{text}; with the best subnetwork always picked the mean would be {scientific(best)}{cost}."


def _specialisation(table: AddressingResult) -> str:
    unused = [index + 1 for index, member in enumerate(table.members) if member.selected is None]
    if unused:
        return f"Subnetwork {listed(list(map(str, unused)))} is never selected: addressing does not use the ensemble."
    ratios = [ratio for member in table.members if (ratio := separation(member)) is not None]
    if not ratios:
        return "The ensemble has one subnetwork, which serves all samples."
    extent = (
        f"{significant(min(ratios), 2)} times"
        if len(ratios) == 1
        else f"{significant(min(ratios), 2)} to {significant(max(ratios), 2)} times"
    )
    word = "specialise" if min(ratios) >= 2 else "hardly specialise"
    return f"The subnetworks {word}: on samples for which they are not selected their error is {extent} as large."


def _addressing(evaluation: Evaluation) -> str:
    table = evaluation.table
    return (
        f"The addressing network ({evaluation.delivered.variant.replace('_', '-')}) selects the best subnetwork for "
        f"{percent(table.agreement)} of the samples; its other choices raise the mean error by "
        f"{scientific(table.regret.mean)}, and the worst single one by {scientific(table.regret.max)}."
    )


def _rollouts(evaluation: Evaluation) -> str:
    rollouts = evaluation.own.rollouts
    assert rollouts is not None
    free, wall = rollouts.no_wall, rollouts.wall
    parts = []
    for name, spread in rollouts.all.mse.items():
        apart = ""
        if free and wall and (without := free.mse.get(name)) and (contact := wall.mse.get(name)):
            apart = f" ({scientific(without.median)} without wall contact, {scientific(contact.median)} with it)"
        if spread is not None:
            parts.append(f"{scientific(spread.median)} for the {name}{apart}")
    several = rollouts.all.episodes > 1
    number = f"{rollouts.all.episodes:,} free-running rollouts" if several else "a free-running rollout"
    which = f", {wall.episodes:,} of them with wall contact," if wall else ""
    if evaluation.rollouts.kind == "recorded":
        which = f" of {evaluation.rollouts.steps:,} steps beside held-out episodes"
    return f"In {number}{which} the median MSE is {listed(parts)}{_leaving(rollouts.left_bounds_share)}."


def _leaving(share: float | None) -> str:
    if share is None:
        return ""
    return f"; {percent(share) if share else 'none'} of them leave{'' if share else 's'} the bounds of the state space"


def _wide_claim(own: Sequence[CandidateResult], wide: Sequence[CandidateResult]) -> str:
    """Hold the paper's claim that one network of 3 x 512 could not learn the dynamics against what it reached here."""
    ours = median(candidate.one_step.scaled.mean for candidate in own)
    theirs = median(candidate.one_step.scaled.mean for candidate in wide)
    if theirs > 100 * ours:
        return (
            "The paper's claim that one wide network is unable to learn the dynamics is borne out: its one-step "
            f"error is {times(theirs / ours)} the ensemble's."
        )
    return (
        "The paper's claim that one wide network is unable to learn the dynamics is not borne out: its mean one-step "
        f"MSE is {scientific(theirs)}, where the ensemble has {scientific(ours)}."
    )


def _bins(comparisons: Sequence[Comparison], title: str) -> str:
    outcome = {"beats": "is better than", "does not beat": "is not better than"}.get(
        beats(comparisons), beats(comparisons)
    )
    return (
        f"With the equal bins of Algorithm 1 the ensemble {outcome} the same ensemble {title}: {_details(comparisons)}."
    )


def _details(comparisons: Sequence[Comparison]) -> str:
    words = {"lower": "lower", "higher": "higher", "unclear": "no clear difference"}
    relations = {comparison.relation for comparison in comparisons}
    if len(relations) > 1:
        return "; ".join(f"{comparison} ({words[comparison.relation]})" for comparison in comparisons)
    common = {"lower": "", "higher": ", each of them higher", "unclear": ", none of them a clear difference"}
    return f"{'; '.join(map(str, comparisons))}{common[relations.pop()]}"


def _rollout_medians(group: Sequence[CandidateResult], name: str) -> list[float]:
    rollouts = [candidate.rollouts for candidate in group if candidate.rollouts is not None]
    return [spread.median for each in rollouts if (spread := each.all.mse.get(name)) is not None]
