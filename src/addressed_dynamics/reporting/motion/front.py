"""The first screen of a report on motion: which model, the closed loop, and its errors block by block."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

from addressed_dynamics.evaluation.motion.records import Candidate, MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Chart, Column, Figure, Front, Row, Table
from addressed_dynamics.reporting.common.numbers import MISSING, significant
from addressed_dynamics.reporting.motion.comparison import compare, outcome, score_of
from addressed_dynamics.reporting.motion.models import UNTRAINED, model_style

NOTHING = "persistence"
"""The group of the reference by which a motion goes on."""

BLOCKS = ("root_velocity", "contact", "joint_position", "joint_velocity", "joint_rotation")
"""Blocks of outputs that the first screen has room for; the section on one step has all."""


def motion_front(
    evaluation: MotionEvaluation, experiment: str, *, made_up: bool, films: Figure | None, loop: Chart | None
) -> Front:
    """Return the first screen.

    Args:
        evaluation: what was measured.
        experiment: name of the experiment; empty if it is not known.
        made_up: whether the data are synthetic.
        films: people in the closed loop.
        loop: the closed loop over time.
    """
    own, run = evaluation.own, evaluation.own.closed_loop.run
    lived = f"all {run.seconds:.0f} s of the test script" if run.alive else f"{run.lived_seconds:.0f} s of the script"
    if not run.alive and run.lived_seconds == run.seconds:
        lived = "no time: it lasts the whole script, but frozen or at no plausible height"
    film = Figure("The closed loop, as fast as it happened; orange: the command.", films.panels[:1]) if films else None
    return Front(
        answers={
            "Model": f"{own.label}, seed {evaluation.delivered.seed}",
            "Closed loop": f"score {significant(own.closed_loop.score)} of 1 under the test script",
            "It lives for": lived,
        },
        load=f'from addressed_dynamics import MotionModel; model = MotionModel.load("data/models/{experiment}")',
        sentences=_sentences(evaluation, made_up=made_up),
        errors=unit_table(evaluation),
        film=film,
        chart=loop,
    )


def best_other(evaluation: MotionEvaluation) -> str | None:
    """Return the group of the other trained model with the highest score in the closed loop; None without any."""
    others = [name for name in evaluation.models if name != evaluation.own_group and name not in UNTRAINED]
    return max(others, key=lambda name: median(map(score_of, evaluation.models[name])), default=None)


def unit_table(evaluation: MotionEvaluation) -> Table:
    """Return the errors in the closed loop and one step ahead, each in its own unit, beside those of others."""
    other = best_other(evaluation)
    groups = [name for name in (evaluation.own_group, other, NOTHING) if name in evaluation.models]
    shown = [_of_seed(evaluation, name) for name in groups if name is not None]
    columns = (
        Column("Error", numeric=False),
        Column("unit", numeric=False),
        *(Column(model_style(name)[0]) for name in groups if name is not None),
    )
    rows = [
        Row((f"closed loop: {title}", unit, *(significant(of) for of in found)), "own")
        for title, unit, found in (
            ("speed", "cm/s", [each.closed_loop.run.moving.speed_error for each in shown]),
            ("heading", "degrees", [each.closed_loop.run.moving.facing_error for each in shown]),
            ("feet that slide", "cm/s", [each.closed_loop.run.all.skate_speed for each in shown]),
        )
    ]
    units = [_one_step(each) for each in shown]
    rows += [
        Row(
            (f"one step: {name.replace('_', ' ')}", unit or MISSING, *(significant(each[name, unit]) for each in units))
        )
        for name, unit in units[0]
        if name in BLOCKS and all((name, unit) in each for each in units)
    ]
    caption = (
        "Mean errors: under the commands of the test script, and one step ahead on "
        f"{evaluation.own.test.rows:,} frames of held-out clips."
    )
    return Table(caption, columns, tuple(rows))


def _one_step(candidate: Candidate) -> dict[tuple[str, str], float]:
    """Return errors one step ahead by name and unit: of blocks, where no distances and angles were measured."""
    if candidate.test.units:
        return {(each.name, each.unit): each.value for each in candidate.test.units}
    return {(each.block, each.unit): each.raw for each in candidate.test.blocks}


def _of_seed(evaluation: MotionEvaluation, group: str) -> Candidate:
    """Return the candidate of the seed that is delivered, or the first."""
    candidates = evaluation.models[group]
    return next((each for each in candidates if each.seed == evaluation.delivered.seed), candidates[0])


def _sentences(evaluation: MotionEvaluation, *, made_up: bool) -> tuple[str, ...]:
    found: list[str] = []
    recommended = evaluation.recommendation
    if recommended and recommended.candidate != evaluation.own_name:
        found.append(f'On validation scripts {recommended.label} does better: load it with candidate="recommended".')
    if other := best_other(evaluation):
        own: Sequence[Candidate] = evaluation.models[evaluation.own_group]
        one = len(own) == 1 or len(evaluation.models[other]) == 1
        seeds = "; of one seed each, a difference may be one between seeds" if one else ""
        found.append(f"It {outcome(compare(own, evaluation.models[other]), f'“{model_style(other)[0]}”')}{seeds}.")
    if made_up:
        found.append("The clips are synthetic, so none of this says how it does on motion capture.")
    return tuple(found)
