"""The report on an experiment of motion as a whole: which sections, tables and figures, in which order."""

from __future__ import annotations

from dataclasses import replace
from statistics import median

from addressed_dynamics.evaluation.motion.records import MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Block, Figure, Fold, Section
from addressed_dynamics.reporting.common.candidates import efforts_of
from addressed_dynamics.reporting.common.document import Account, specialisation_blocks
from addressed_dynamics.reporting.common.figures.specialisation import Words
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.common.targets import reached
from addressed_dynamics.reporting.motion import loop_tables, tables
from addressed_dynamics.reporting.motion.figures import addressing, closed_loop, films, one_step
from addressed_dynamics.reporting.motion.front import best_other, motion_front
from addressed_dynamics.reporting.motion.paper import SOURCES
from addressed_dynamics.reporting.motion.recorded import data_blocks
from addressed_dynamics.reporting.motion.results import MotionResults
from addressed_dynamics.reporting.motion.settings import model_words
from addressed_dynamics.reporting.motion.targets import judge_targets, targets_caption
from addressed_dynamics.reporting.motion.verdict import findings, verdict
from addressed_dynamics.sources.motion.params import MotionFeatureParams

WORDS = Words(held_out="held-out clips", scaled="normalised outputs", validation="validation clips")
"""What samples and losses of motion are called."""


def motion_account(results: MotionResults, origin: Origin[MotionFeatureParams], *, paper: bool) -> Account:
    """Return all that there is to tell of motion.

    Args:
        results: what was measured.
        origin: where it comes from.
        paper: whether what the paper states of motion stands beside the figures.
    """
    evaluation, made_up = results.evaluation, results.data.made_up
    delivered = evaluation.delivered
    targets = judge_targets(evaluation)
    seen = films.films(evaluation, results.arrays)
    other = best_other(evaluation)
    found = (
        Section("Closed loop", _loop_blocks(results, seen)),
        Section("One step ahead", _one_step_blocks(results, origin, paper=paper)),
        Section("Candidates", (tables.seed_table(evaluation),)),
    )
    return Account(
        subtitle=subtitle(made_up=made_up),
        verdict=verdict(evaluation, targets, made_up=made_up),
        titles={name: each.label for name, each in evaluation.candidates.items()},
        front=motion_front(
            evaluation,
            origin.experiment,
            made_up=made_up,
            films=seen,
            loop=closed_loop.over_time(evaluation, results.arrays, other),
        ),
        findings=findings(evaluation, made_up=made_up, target=origin.features.target, paper=paper),
        targets=targets,
        targets_title="The paper's figures" if paper else "Targets",
        targets_caption=targets_caption(len(evaluation.models[evaluation.own_group]), paper=paper),
        paper=paper,
        model=model_words(origin.features, delivered.mode),
        seed=delivered.seed,
        data=data_blocks(results.data),
        found=found,
        method=(Section("Addressing", addressing_blocks(evaluation, paper=paper)),),
        words=replace(WORDS, paper=paper),
        sources=SOURCES,
    )


def subtitle(*, made_up: bool) -> str:
    """Return the line below the title, which says plainly when the data are synthetic."""
    data = "SYNTHETIC clips of a made-up walker, not motion capture" if made_up else "motion capture"
    return f"A character under commands, learned from {data}"


def motion_headline(results: MotionResults) -> dict[str, float]:
    """Return the figures that a table of runs should show."""
    evaluation = results.evaluation
    own = evaluation.own
    figures = {
        "mae/test": own.test.raw,
        "mae_normalised/test": own.test.normalised,
        "closed_loop/score": own.closed_loop.score,
        "agreement": evaluation.addressing.test.specialisation.agreement,
        "phase_information": evaluation.addressing.test.all.information_share,
        "targets/reached": float(reached(judge_targets(evaluation))),
    }
    if pfnn := evaluation.models.get("phase_functioned"):
        figures |= {
            "pfnn/mae/test": median(each.test.raw for each in pfnn),
            "pfnn/closed_loop/score": median(each.closed_loop.score for each in pfnn),
        }
    return figures


def addressing_blocks(evaluation: MotionEvaluation, *, paper: bool = False) -> tuple[Block, ...]:
    """Return the section on who serves which frames; nothing if there is one network.

    Args:
        evaluation: what was measured.
        paper: whether the experiment is the paper's, so that its figures are cited.
    """
    found = evaluation.addressing
    if found.members < 2:
        return ()
    return (
        addressing.phase_shares(found, paper=paper),
        tables.phase_table(evaluation),
        *specialisation_blocks(found.specialisations, replace(WORDS, paper=paper)),
    )


def _loop_blocks(results: MotionResults, seen: Figure) -> tuple[Block, ...]:
    evaluation, arrays = results.evaluation, results.arrays
    others = seen.panels[1:]
    return (
        closed_loop.scores(evaluation),
        closed_loop.paths(evaluation, arrays),
        *((Figure(seen.caption, others),) if others else ()),
        loop_tables.loop_table(evaluation),
        Fold(
            "By kind of command, and by the use of the addressing network",
            (loop_tables.kind_table(evaluation), loop_tables.mode_table(evaluation)),
        ),
    )


def _one_step_blocks(results: MotionResults, origin: Origin[MotionFeatureParams], *, paper: bool) -> tuple[Block, ...]:
    evaluation = results.evaluation
    by_seed = efforts_of(results.baselines, origin.ensemble, evaluation.splits.get("train"))
    efforts = {name.partition("/seed-")[0]: each for name, each in by_seed.items()}
    return (
        tables.block_table(evaluation),
        one_step.frames_over_time(evaluation, results.arrays, cited=" (Fig. 7 of the paper)" * paper),
        Fold(
            "All candidates one step ahead, and every joint",
            (tables.one_step_table(evaluation, efforts, paper=paper), one_step.joint_errors(evaluation)),
        ),
    )
