"""The verdict: from numbers to sentences that follow from them, favourable or not."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import mean

from addressed_dynamics.evaluation.common.bootstrap import COVERAGE, DRAWS, FEWEST_EPISODES
from addressed_dynamics.evaluation.common.sizes import total_size
from addressed_dynamics.evaluation.transitions.records import (
    ADDRESSED,
    REFERENCES,
    AddressingResult,
    Evaluation,
    Recommendation,
)
from addressed_dynamics.evaluation.transitions.rollouts import FLOWN_WIDTHS
from addressed_dynamics.reporting.common.comparison import MARGIN
from addressed_dynamics.reporting.common.figures.style import model_style
from addressed_dynamics.reporting.common.numbers import (
    in_words,
    listed,
    percent,
    power_of_ten,
    scientific,
    significant,
    times,
)
from addressed_dynamics.reporting.common.targets import Target, reached_words
from addressed_dynamics.reporting.transitions.baseline_findings import baseline_findings
from addressed_dynamics.reporting.transitions.comparison import MOST_NUMBERS, beats, compare
from addressed_dynamics.reporting.transitions.paper import AngleFigures, PaperFigures
from addressed_dynamics.reporting.transitions.rollout_tables import episodes_words, lost_sentence
from addressed_dynamics.reporting.transitions.targets import separation

SIMPLEST = "the simplest of those that are about as good as the best"


def verdict(evaluation: Evaluation, targets: Sequence[Target], paper: PaperFigures | None) -> str:
    """Return the result in a few sentences, the first of which says which model is delivered, and why."""
    sentences = [_delivered(evaluation)]
    what = "figures taken from the paper" if paper and paper.table else "targets"
    if targets:
        sentences.append(f"The addressed ensemble reaches {reached_words(targets, what)}.")
    single = evaluation.baseline("total_parameters")
    if single:
        subject = "It" if targets else "The addressed ensemble"
        relation = beats(compare(evaluation.own_seeds, single))
        sentences.append(
            f"{subject} {relation} one network of {total_size(single[0].parameters, evaluation.own.parameters)}, "
            "trained for as many updates."
        )
    return " ".join(sentences)


def _delivered(evaluation: Evaluation) -> str:
    """Return which model is delivered and why, and what the best reaches on validation episodes."""
    found, why = evaluation.recommendation, evaluation.choice.why
    asked = "Delivered is the addressed ensemble, as the params file asks"
    if found is None:
        unmeasured = "Delivered is the addressed ensemble, for there are no validation episodes to choose by"
        return f"{asked if why == 'asked' else unmeasured}."
    best, label = found.scores[found.candidate], _named(found.label)
    reached = (
        f"on validation episodes its error is {significant(best.one_step_percent, 2)} % of the range after a step, and "
        f"its rollouts keep it below 10 % for {significant(best.horizon_seconds, 3)} s"
    )
    if found.candidate == ADDRESSED:
        rank = "the best" if found.best is None else SIMPLEST
        first = f"{asked}, and it is {rank}" if why == "asked" else f"Delivered is the addressed ensemble, {rank}"
        return f"{first}: {reached}{_better_in_a_step(found)}."
    beside = ""
    if own := found.scores.get(ADDRESSED):
        beside = (
            f", where the addressed ensemble has {significant(own.one_step_percent, 2)} % and "
            f"{significant(own.horizon_seconds, 3)} s"
        )
        if own.horizon_seconds == best.horizon_seconds:
            whole = [f"{significant(each.rollout_percent, 2)} %" for each in (best, own)]
            beside += f", and over whole rollouts {whole[0]}, where that has {whole[1]}"
    none_better = "" if found.beats_references else ", for no trained model is worth more"
    if why == "asked":
        return (
            f"{asked}, but load {label} (candidate='recommended'){none_better}: {reached}{beside}"
            f"{_better_in_a_step(found)}."
        )
    if none_better:
        return f"Delivered is {label}{none_better}: {reached}{beside}."
    rank = "the best" if found.best is None else SIMPLEST
    return f"Delivered is {label}, {rank}: {reached}{beside}{_better_in_a_step(found)}."


def _named(label: str) -> str:
    """Return what a candidate is called inside a sentence."""
    return f"the {label}" if label.startswith("ensemble") else label


def _better_in_a_step(recommendation: Recommendation) -> str:
    """Return half a sentence if a reference is better one step ahead than the recommended model; else nothing."""
    own = recommendation.scores[recommendation.candidate]
    references = {name: score for name, score in recommendation.scores.items() if name.partition("/")[0] in REFERENCES}
    if not references:
        return ""
    name = min(references, key=lambda each: references[each].one_step_percent)
    best = references[name]
    if own.one_step_percent <= best.one_step_percent:
        return ""
    title, _ = model_style(name)
    lost = (
        f", but lost after {significant(best.horizon_seconds, 3)} s"
        if best.horizon_seconds < own.horizon_seconds
        else ""
    )
    return f"; one step ahead {title} is better ({significant(best.one_step_percent, 2)} %){lost}"


def findings(evaluation: Evaluation, paper: PaperFigures | None) -> tuple[str, ...]:
    """Return the sentences that the verdict rests on.

    Args:
        evaluation: what was measured.
        paper: what the paper reports on this experiment; None if nothing.
    """
    own = evaluation.own_seeds
    sentences = [*_of_delivered(evaluation), _one_step(evaluation)]
    if paper and paper.angles:
        sentences.append(_angles(evaluation, paper.angles))
    sentences += [_specialisation(evaluation.table), _addressing(evaluation)]
    if paper and paper.agreement is not None:
        train, test = evaluation.specialisation.train.agreement, evaluation.specialisation.test.agreement
        sentences.append(
            f"On the training points the selected subnetwork has the lowest loss for {percent(train)} of them, where "
            f"the paper has {percent(paper.agreement)}; on held-out episodes for {percent(test)}."
        )
    if evaluation.own.rollouts is not None:
        sentences.append(_rollouts(evaluation))
    sentences += _flown_off(evaluation)
    sentences += baseline_findings(evaluation, paper)
    if len(own) > 1:
        means = [candidate.one_step.scaled.mean for candidate in own]
        sentences.append(
            f"From {len(own)} seeds the mean one-step {evaluation.loss.upper()} lies between {scientific(min(means))} "
            f"and {scientific(max(means))}."
        )
    if len(evaluation.candidates) > len(own):
        sentences.append(
            "Comparisons are of medians over seeds; an error counts as lower if it is so from every seed and by more "
            f"than {percent(MARGIN - 1, 0)}{_resampled(evaluation)}."
        )
    return tuple(sentences)


def _of_delivered(evaluation: Evaluation) -> list[str]:
    """Return what the delivered model reaches on held-out episodes, if it is not the ensemble the rest is about."""
    if evaluation.choice.candidate == ADDRESSED:
        return []
    chosen, own = evaluation.chosen, evaluation.own
    return [
        f"On held-out episodes {_named(chosen.label)}, which is delivered, has a mean {evaluation.loss.upper()} of "
        f"{scientific(chosen.one_step.scaled.mean)} one step ahead, of states scaled to [0, 1]; what follows is about "
        f"the addressed ensemble, which has {scientific(own.one_step.scaled.mean)}."
    ]


def _resampled(evaluation: Evaluation) -> str:
    """Say what else a comparison asks for, where it is known."""
    if not any(each.beside_ensemble for each in evaluation.candidates.values()):
        return ""
    return (
        f", and if the {percent(COVERAGE, 0)} interval of the other's error in multiples of the ensemble's "
        f"({DRAWS:,} draws of the held-out episodes, of which {FEWEST_EPISODES} are the least) does not have 1 in it"
    )


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
    members = len(evaluation.table.members)
    text += (
        f"; in hindsight, with the best of the {in_words(members)} subnetworks picked for every transition, the mean "
    )
    guesses = evaluation.candidates.get("ensemble/guesses")
    beside = (
        f", and with the best of as many random guesses of the same spread {scientific(guesses.one_step.scaled.mean)}"
        if guesses and members > 1
        else ""
    )
    return f"{text}would be {scientific(best)}{cost}{beside}."


def _specialisation(table: AddressingResult) -> str:
    unused = [str(index + 1) for index, member in enumerate(table.members) if member.selected is None]
    if unused:
        which = f"Subnetwork {unused[0]} is" if len(unused) == 1 else f"Subnetworks {listed(unused)} are"
        return f"{which} never selected: addressing does not use the whole ensemble."
    ratios = [ratio for member in table.members if (ratio := separation(member)) is not None]
    if not ratios:
        return "The ensemble has one subnetwork, which serves all samples."
    low, high = (significant(reduce(ratios), 2) for reduce in (min, max))
    extent = f"{low} times" if low == high else f"{low} to {high} times"
    special = sum(ratio >= 2 for ratio in ratios)
    subject = "The subnetworks specialise"
    if not special:
        subject = "The subnetworks hardly specialise"
    elif special < len(ratios):
        plural = "specialises" if special == 1 else "specialise"
        subject = f"Of the {in_words(len(ratios))} subnetworks {in_words(special)} {plural}"
    return f"{subject}: on samples for which they are not selected their error is {extent} as large."


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
    recorded = evaluation.rollouts.kind == "recorded"
    free, wall = (None if recorded else rollouts.groups.get(name) for name in ("no_wall", "wall"))
    parts = []
    for name, spread in rollouts.all.mse.items():
        apart = ""
        if free and wall and (without := free.mse.get(name)) and (contact := wall.mse.get(name)):
            apart = f" ({scientific(without.median)} without wall contact, {scientific(contact.median)} with it)"
        if spread is not None:
            parts.append(f"{scientific(spread.median)} for the {name}{apart}")
    if len(parts) > MOST_NUMBERS:
        known = {name: spread.median for name, spread in rollouts.all.mse.items() if spread is not None}
        low, high = (reduce(known, key=lambda name: known[name]) for reduce in (min, max))
        parts = [f"between {scientific(known[low])} ({low}) and {scientific(known[high])} ({high})"]
    several = rollouts.all.number > 1
    number = f"{rollouts.all.number:,} free-running rollouts" if several else "a free-running rollout"
    which = f", {wall.number:,} of them with wall contact," if wall else ""
    if recorded:
        which = f" of {evaluation.rollouts.steps:,} steps beside {episodes_words(rollouts.all)}"
    physics = evaluation.rollouts.physics
    lost = f" {lost_sentence(evaluation, physics)}" if physics else ""
    return f"In {number}{which} the median MSE is {listed(parts)}{_leaving(rollouts.left_bounds_share)}.{lost}"


def _flown_off(evaluation: Evaluation) -> list[str]:
    """Say how many rollouts of the delivered model fly off, if any does."""
    chosen = evaluation.chosen
    if chosen.rollouts is None or not chosen.rollouts.flown_off_share:
        return []
    share = percent(chosen.rollouts.flown_off_share)
    return [
        f"Of the rollouts of {_named(chosen.label)}, which is delivered, {share} fly off: a state gets outside of the "
        f"range of the training data by more than {FLOWN_WIDTHS:g} times its width, or is no number any more."
    ]


def _leaving(share: float | None) -> str:
    if share is None:
        return ""
    return f"; {percent(share) if share else 'none'} of them leave{'' if share else 's'} the bounds of the state space"


def _angles(evaluation: Evaluation, angles: AngleFigures) -> str:
    """Hold the errors that the paper states against those measured, squared and absolute: it does not say which."""
    one_step = evaluation.own.one_step
    parts = []
    for what, names, unit, square, reported in (
        ("cosines and sines", angles.direction_names, "", "", angles.direction_error),
        ("angles", angles.angle_names, " rad", " rad²", angles.angle_error),
        ("velocities", angles.velocity_names, " rad/s", " (rad/s)²", angles.velocity_error),
    ):
        found = one_step.named(names)
        absolute, squared = (mean([getattr(each, kind).mean for each in found]) for kind in ("absolute", "squared"))
        parts.append(
            f"{what} {scientific(absolute)}{unit} and {scientific(squared)}{square} (the paper: about "
            f"{power_of_ten(reported)})"
        )
    return f"One step ahead, mean absolute error and mean square: {'; '.join(parts)}."
