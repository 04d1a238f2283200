"""What is to be reached by the model of motion, and whether it is."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from addressed_dynamics.evaluation.motion.closed_loop.judging import ALIVE_SHARE
from addressed_dynamics.evaluation.motion.records import Candidate, MotionEvaluation
from addressed_dynamics.reporting.common.numbers import MISSING, percent, significant
from addressed_dynamics.reporting.common.targets import Target
from addressed_dynamics.reporting.motion.comparison import middle, normalised_error, raw_error, score_of

LIMB_FACTOR = 1.5
"""Limbs move as in recorded motion if their speed is within this factor of it, up or down."""


def judge_targets(evaluation: MotionEvaluation) -> tuple[Target, ...]:
    """Hold the delivered kind of model, from all its seeds, against what it should reach."""
    own, pfnn = evaluation.models[evaluation.own_group], evaluation.models.get("phase_functioned", [])
    return (
        _error_target(own, pfnn),
        _score_target(own, pfnn),
        _limb_target(evaluation, own),
        _alive_target(own),
        _phase_target(evaluation),
    )


PAPER_NOTE = (
    " The errors that the paper states of PFNN and of its own model are no targets, because it does not say in which "
    "unit they are, and its PFNN is worse than one that is trained well."
)


def targets_caption(seeds: int, *, paper: bool) -> str:
    """Return what the table of targets shows of a model from so many seeds."""
    over = f"medians over {seeds} seeds" if seeds > 1 else "one seed of each model"
    return f"What the delivered model should reach: {over}.{PAPER_NOTE * paper}"


def expected_limb_speed(evaluation: MotionEvaluation) -> float | None:
    """Return how fast recorded limbs move in the gaits that the script asks for, weighted by its frames, in cm/s.

    None if the script never asks to move.
    """
    frames, total = 0, 0.0
    for kind in evaluation.own.closed_loop.run.kinds:
        if kind.kind.startswith(("walk", "jog")):
            asked = kind.frames + kind.lost
            frames += asked
            total += asked * evaluation.reference.of(kind.kind.partition("_")[0]).limb_speed
    return total / frames if frames else None


def _error_target(own: Sequence[Candidate], pfnn: Sequence[Candidate]) -> Target:
    raw, normalised = (median(map(of, own)) for of in (raw_error, normalised_error))
    found = f"{significant(raw)} and {significant(normalised)}"
    name = "MAE on held-out clips, one step ahead, raw and normalised"
    if not pfnn:
        return Target(name, "below that of the PFNN trained here", f"{found}; no PFNN was trained", None)
    bounds = tuple(median(map(of, pfnn)) for of in (raw_error, normalised_error))
    wanted = f"below the PFNN trained here: {significant(bounds[0])} and {significant(bounds[1])}"
    return Target(name, wanted, found, raw < bounds[0] and normalised < bounds[1])


def _score_target(own: Sequence[Candidate], pfnn: Sequence[Candidate]) -> Target:
    score, name = median(map(score_of, own)), "Score in the closed loop, 0 to 1"
    if not pfnn:
        wanted = "at least that of the PFNN trained here"
        return Target(name, wanted, f"{significant(score)}; no PFNN was trained", None)
    bound = median(map(score_of, pfnn))
    return Target(
        name, f"at least that of the PFNN trained here: {significant(bound)}", significant(score), score >= bound
    )


def _limb_target(evaluation: MotionEvaluation, own: Sequence[Candidate]) -> Target:
    expected = expected_limb_speed(evaluation)
    speed = middle(own, lambda each: each.closed_loop.run.moving.limb_speed)
    frozen = middle(own, lambda each: each.closed_loop.run.moving.frozen_share)
    name = "Speed of the limbs while told to move, and frames in which they are frozen"
    most = 1.0 - ALIVE_SHARE
    wanted = (
        f"within a factor of {LIMB_FACTOR:g} of recorded motion: {significant(expected)} cm/s; "
        f"at most {percent(most, 0)}"
    )
    if expected is None or speed is None or frozen is None:
        return Target(name, wanted, MISSING, None)
    met = expected / LIMB_FACTOR <= speed <= expected * LIMB_FACTOR and frozen <= most
    return Target(name, wanted, f"{significant(speed)} cm/s; {percent(frozen)}", met)


def _alive_target(own: Sequence[Candidate]) -> Target:
    runs = [each.closed_loop.run for each in own]
    alive = sum(run.alive for run in runs)
    lived = min(run.lived_seconds for run in runs)
    wanted = f"for the whole script of {runs[0].seconds:.0f} s" + (", from every seed" if len(runs) > 1 else "")
    found = f"{lived:.0f} s" if len(runs) == 1 else f"{alive} of {len(runs)} seeds; the shortest run {lived:.0f} s"
    if alive < len(runs) and lived == runs[0].seconds:
        found += ", but frozen or not at a plausible height"
    return Target("Alive in the closed loop", wanted, found, alive == len(runs))


def _phase_target(evaluation: MotionEvaluation) -> Target:
    use, members = evaluation.addressing.test.all, evaluation.addressing.members
    name = "Information on the phase, which no network is given, in the choice of a network"
    if members < 2:
        return Target(name, "above chance", "there is one network, and no choice", None)
    bound = use.chance_share_p95
    return Target(
        name,
        f"above chance, on held-out clips: {percent(bound)} of the choice (95th percentile)",
        percent(use.information_share),
        use.information_share > bound,
    )
