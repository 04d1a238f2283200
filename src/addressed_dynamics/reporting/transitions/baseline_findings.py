"""Sentences that hold the addressed ensemble against what it is compared with, favourable or not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from addressed_dynamics.evaluation.common.sizes import total_size
from addressed_dynamics.evaluation.transitions.records import CandidateResult, Evaluation
from addressed_dynamics.reporting.common.comparison import Comparison
from addressed_dynamics.reporting.common.figures.style import model_style
from addressed_dynamics.reporting.common.numbers import in_words, listed, scientific, times
from addressed_dynamics.reporting.transitions.comparison import beats, compare, details, spread_over_seeds
from addressed_dynamics.reporting.transitions.paper import PaperFigures
from addressed_dynamics.reporting.transitions.recipes import recipes_finding


def baseline_findings(evaluation: Evaluation, paper: PaperFigures | None) -> list[str]:
    """Return a sentence on each baseline that was trained.

    Args:
        evaluation: what was measured.
        paper: what the paper reports on this experiment; None if nothing.
    """
    sentences = []
    if single := evaluation.baseline("total_parameters"):
        size = total_size(single[0].parameters, evaluation.own.parameters)
        sentences.append(_specialists(evaluation, single, f"one network of {size}, trained as long"))
    if member := evaluation.baseline("same_size"):
        sentences.append(_specialists(evaluation, member, "one network as large as a member, trained as long"))
    sentences += _single_networks(evaluation, paper)
    for name, title in {"unequal_bins": "without equal bins", "random_bins": "with fixed random bins"}.items():
        if other := evaluation.baseline(name):
            sentences.append(_bins(compare(evaluation.own_seeds, other), title))
    if recipes := recipes_finding(evaluation):
        sentences.append(recipes)
    return sentences


def _specialists(evaluation: Evaluation, single: Sequence[CandidateResult], title: str) -> str:
    comparisons = compare(evaluation.own_seeds, single)
    members = len(evaluation.table.members)
    subject = f"Hard addressing of {in_words(members)} specialists" if members > 1 else "The one subnetwork"
    return (
        f"{subject} {beats(comparisons)} {title}: {spread_over_seeds(comparisons[0])}{_in_rollouts(comparisons[1:])}."
    )


def _in_rollouts(comparisons: Sequence[Comparison]) -> str:
    return f"; {details(comparisons)}" if comparisons else ""


def _single_networks(evaluation: Evaluation, paper: PaperFigures | None) -> list[str]:
    """Hold the model against the other single networks: in all errors if there is one, else one step ahead."""
    own, names = evaluation.own_seeds, evaluation.single_networks
    claimed = paper is not None and paper.wide_network_fails
    if names == ["wide"]:
        wide = evaluation.baseline("wide")
        comparisons = compare(own, wide)
        title = "the paper's one wide network" if claimed else "one wide network"
        sentences = [f"It {beats(comparisons)} {title}: {details(comparisons)}."]
    elif names:
        sentences = [_one_step_against(own, {name: evaluation.baseline(name) for name in names})]
    else:
        return []
    if claimed and "wide" in names:
        sentences.append(_wide_claim(own, evaluation.baseline("wide"), evaluation.loss))
    return sentences


def _one_step_against(own: Sequence[CandidateResult], others: Mapping[str, Sequence[CandidateResult]]) -> str:
    first = {model_style(name)[0]: compare(own, group)[0] for name, group in others.items()}
    ours = median(next(iter(first.values())).own)
    errors = listed([f"{title} {scientific(median(each.other))}" for title, each in first.items()])
    lower = [title for title, each in first.items() if each.relation == "better"]
    below = "all of them" if len(lower) == len(first) else listed(lower) if lower else "none of them"
    return (
        f"Of other single networks that were trained as long, the error one step ahead is: {errors}; the ensemble's, "
        f"{scientific(ours)}, is clearly lower than that of {below}."
    )


def _wide_claim(own: Sequence[CandidateResult], wide: Sequence[CandidateResult], loss: str) -> str:
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
        f"{loss.upper()} is {scientific(theirs)}, where the ensemble has {scientific(ours)}."
    )


def _bins(comparisons: Sequence[Comparison], title: str) -> str:
    outcome = {"beats": "is better than", "does not beat": "is not better than"}.get(
        beats(comparisons), beats(comparisons)
    )
    return (
        f"With the equal bins of Algorithm 1 the ensemble {outcome} the same ensemble {title}: {details(comparisons)}."
    )
