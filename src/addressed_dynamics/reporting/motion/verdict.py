"""The verdict on a model of motion: from numbers to sentences that follow from them, favourable or not."""

from __future__ import annotations

from collections.abc import Sequence

from addressed_dynamics.evaluation.motion.records import MotionEvaluation, Recommendation
from addressed_dynamics.reporting.common.comparison import MARGIN
from addressed_dynamics.reporting.common.numbers import percent, significant
from addressed_dynamics.reporting.common.targets import Target, reached_words
from addressed_dynamics.reporting.motion.comparison import SCORE_MARGIN, compare, details, outcome, raw_error, score_of
from addressed_dynamics.reporting.motion.findings import (
    addressing,
    closed_loop,
    near_copies,
    one_step,
    own_group,
    ranks,
    trajectory,
    unseen_gaits,
)
from addressed_dynamics.reporting.motion.models import CLOSEST

IN_SENTENCES = {
    "phase_functioned": "the PFNN trained here",
    CLOSEST: "one network of as many parameters",
    "learned_blend": "a network whose parameters a gate mixes",
    "same_size": "one network as large as a single member",
    "paper_recipe": "the ensemble with the paper's recipe",
    "default_recipe": "the ensemble with the default recipe",
    "released": "the published PFNN, which has learned from other data",
}
"""What sentences call the models that ours is compared with."""


def verdict(evaluation: MotionEvaluation, targets: Sequence[Target], *, made_up: bool) -> str:
    """Return the result in a few sentences, the first of which says which model to use."""
    on = "On synthetic clips the" if made_up else "The"
    sentences = [_recommended(evaluation, evaluation.recommendation)] if evaluation.recommendation else []
    sentences += [f"{on} addressed ensemble reaches {reached_words(targets)}."]
    own = own_group(evaluation)
    relations = [
        outcome(compare(own, evaluation.models[name]), IN_SENTENCES[name])
        for name in ("phase_functioned", CLOSEST)
        if name in evaluation.models
    ]
    if relations:
        sentences.append(f"It {'; it '.join(relations)}.")
    return " ".join(sentences)


def _recommended(evaluation: MotionEvaluation, found: Recommendation) -> str:
    """Return which model to use, and what it reaches on validation data."""

    def reached(name: str) -> str:
        score = found.scores[name]
        return f"{score.closed_loop:.2f} in the closed loop and {significant(score.mae_normalised)} one step ahead"

    on = "on validation data (score from 0 to 1, and normalised MAE) it reaches"
    if found.candidate == evaluation.own_name or evaluation.own_name not in found.scores:
        return f"Use the {found.label}: {on} {reached(found.candidate)}."
    label = f"the {found.label}" if found.label.startswith("ensemble") else found.label
    return (
        f"Use {label} (candidate='recommended'): {on} {reached(found.candidate)}, where the delivered ensemble "
        f"has {reached(evaluation.own_name)}."
    )


def findings(evaluation: MotionEvaluation, *, made_up: bool, target: str, paper: bool) -> tuple[str, ...]:
    """Return the sentences that the verdict rests on.

    Args:
        evaluation: what was measured.
        made_up: whether the data are synthetic.
        target: what our networks are asked for, as `MotionFeatureParams.target`.
        paper: whether the paper's figures stand beside ours.
    """
    sentences = [
        one_step(evaluation),
        unseen_gaits(evaluation),
        *_comparisons(evaluation),
        trajectory(evaluation, target),
        closed_loop(evaluation),
        ranks(evaluation),
        *addressing(evaluation),
        near_copies(evaluation) if paper else "",
        *_seeds(evaluation),
    ]
    if made_up:
        sentences.append(
            "The clips are synthetic: a walker made up by a program. The comparisons hold for these data alone"
            f"{', and none of the figures can stand beside those of the paper' * paper}."
        )
    return tuple(sentence for sentence in sentences if sentence)


def _comparisons(evaluation: MotionEvaluation) -> list[str]:
    own = own_group(evaluation)
    return [
        f"Beside {title}: {details(compare(own, evaluation.models[name]))}."
        for name, title in IN_SENTENCES.items()
        if name in evaluation.models
    ]


def _seeds(evaluation: MotionEvaluation) -> list[str]:
    own = own_group(evaluation)
    rule = (
        "Comparisons are of medians over seeds: an error or a speed counts as better or worse if it differs from every "
        f"seed by more than {percent(MARGIN - 1, 0)}, a score if it does by more than {SCORE_MARGIN:g}."
    )
    if len(own) == 1:
        return [f"{rule} With one seed of each, a difference may be one between seeds."]
    scores, errors = [score_of(each) for each in own], [raw_error(each) for each in own]
    return [
        f"From {len(own)} seeds the raw MAE lies between {significant(min(errors))} and {significant(max(errors))}, "
        f"and the closed-loop score between {significant(min(scores))} and {significant(max(scores))}.",
        rule,
    ]
