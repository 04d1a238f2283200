"""Tables of the closed loop."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from statistics import mean, median

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.closed_loop.judging import ALIVE_SHARE, CYCLE, FROZEN_SPEED, SETTLING
from addressed_dynamics.evaluation.motion.closed_loop.measures import GaitReference
from addressed_dynamics.evaluation.motion.records import Candidate, ClosedLoop, KindResult, MotionEvaluation
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.numbers import MISSING, percent, significant
from addressed_dynamics.reporting.motion.comparison import middle, normalised_error, raw_error, score_of
from addressed_dynamics.reporting.motion.models import main_models, model_style
from addressed_dynamics.reporting.motion.tables import row_kind

KINDS = {
    "stand": "stand",
    "walk": "walk straight on",
    "walk_turn": "walk and turn",
    "jog": "jog straight on",
    "jog_turn": "jog and turn",
}
"""What commands ask for."""
Figure = Callable[[Candidate], float | None]


def loop_table(evaluation: MotionEvaluation) -> Table:
    """Return how all candidates do in the closed loop, beside recorded motion."""
    columns = (
        Column("Model", numeric=False),
        Column("score"),
        Column("alive", numeric=False),
        Column("speed off", "while it should move"),
        Column("facing off", "while it should move"),
        Column("limbs", "while it should move"),
        Column("frozen", "while it should move"),
        Column("skate", "feet"),
        Column("slowest", "feet"),
        Column("contact", "feet"),
        Column("mean", "bone drift"),
        Column("largest", "bone drift"),
    )
    rows = [_recorded_row(gait) for gait in evaluation.reference.gaits]
    ordered = sorted(evaluation.groups.items(), key=lambda item: -median(map(score_of, item[1])))
    rows += [Row(_loop_cells(group), row_kind(evaluation, name)) for name, group in ordered]
    seconds = evaluation.own.closed_loop.run.seconds
    caption = (
        f"{seconds:.0f} s of commands (stand, walk, turn both ways, jog, turn both ways, stop), under which each "
        "model lives on its own predictions, with the published controller of PFNN; by score. Above: the frames that "
        f"were trained on, by gait. The first {SETTLING / FRAME_RATE:g} s of every command do not count. Speeds are "
        "in cm/s, angles in degrees. Speed off: mean difference from the commanded speed, either way; facing off: "
        "mean angle to the command; limbs: mean speed of the joints relative to the root; frozen: share of frames in "
        f"which that is below {FROZEN_SPEED:g} cm/s on average over {CYCLE / FRAME_RATE:g} s. Skate: speed along the "
        "ground of heels and toes that the model itself says touch it; slowest: that of the slowest of the four, "
        "whatever the model says; contact: share of heels and toes that touch. Bone drift: by what share bones are "
        "too long or too short. Alive: lasts the whole script (else how long), is frozen in at most "
        f"{percent(1 - ALIVE_SHARE, 0)} of the frames in which it should move, and keeps its hips at a plausible "
        "height."
    )
    return Table(caption, columns, tuple(rows))


def kind_table(evaluation: MotionEvaluation) -> Table:
    """Return how ours and what it is mainly compared with follow each kind of command."""
    shown = list(main_models(evaluation).items())[:2]
    columns = (
        Column("Command", numeric=False),
        Column("asked, cm/s"),
        *(
            Column(name, model_style(group)[0])
            for group, _ in shown
            for name in ("speed", "facing off, °", "limbs, cm/s", "slowest foot, cm/s")
        ),
    )
    rows = []
    for kind, title in KINDS.items():
        found = [evaluation.candidates[name].closed_loop.run.of(kind) for _, name in shown]
        asked = next((each.commanded_speed for each in found if each is not None and each.frames), None)
        cells = [cell for each in found for cell in _kind_cells(each)]
        if any(each is not None for each in found):
            rows.append(Row((title, significant(asked), *cells)))
    return Table(
        f"The same by kind of command, seed {evaluation.delivered.seed}: speed of the root in cm/s, angle between "
        "where it faces and the command, mean speed of the limbs, and speed of the slowest heel or toe.",
        columns,
        tuple(rows),
    )


def mode_table(evaluation: MotionEvaluation) -> Table:
    """Return how the mode of addressing was chosen."""
    columns = (
        Column("Addressing", numeric=False),
        Column("best seed", "score, validation scripts"),
        Column("mean", "score, validation scripts"),
        Column("median", "score, test script"),
        Column("raw", "MAE, held-out clips"),
        Column("normalised", "MAE, held-out clips"),
    )
    told = {
        "argmax": "argmax: the network with the highest output (the paper)",
        "sample": "sample: a network drawn by the outputs",
        "mixture": "mixture: predictions weighted by the outputs",
        "blend": "blend: parameters weighted by the outputs",
    }
    rows = []
    for mode, group in evaluation.modes.items():
        chosen_by = [score for each in group if (score := each.closed_loop.validation_score) is not None]
        validation = [f"{pick(chosen_by):.3f}" if chosen_by else MISSING for pick in (max, mean)]
        figures = (median(map(of, group)) for of in (score_of, raw_error, normalised_error))
        cells = (told.get(mode, mode), *validation, *(significant(each) for each in figures))
        rows.append(Row(cells, "own" if mode == evaluation.delivered.mode else ""))
    caption = (
        "How the outputs of the addressing network are used. Delivered are the seed and mode with the highest score on "
        f"random scripts of commands that are for choosing only, seed {evaluation.delivered.seed} and "
        f"{evaluation.delivered.mode}; neither the test script nor held-out frames had a part in it."
    )
    return Table(caption, columns, tuple(rows))


def score_words(closed_loop: ClosedLoop) -> str:
    """Return what the score is made of."""
    return (
        f"The score is a mean over the settled frames of all {closed_loop.run.seconds:.0f} s, in which frames after a "
        "run's death count 0. While a character should move it gets its liveliness (0 for frozen limbs, 1 for limbs "
        "of ordinary speed, 0 again if they shake) times the mean of four shares: following (velocity against "
        "command), facing (1 at the commanded heading, 0 at 90 degrees), grip (1 if one heel or toe stands still, 0 "
        "for a sliding pose) and shape (bones of recorded length, hips at a plausible height); while it should stand, "
        "the mean of following, grip and shape. Nobody gets 1, for turns are followed late."
    )


def _recorded_row(gait: GaitReference) -> Row:
    speeds = (gait.limb_speed, None, gait.skate_speed, gait.slowest_foot_speed)
    name = "recorded, all frames" if gait.gait == "all" else f"recorded, {gait.gait}"
    cells = (MISSING, MISSING, MISSING, MISSING, *(significant(speed) for speed in speeds))
    return Row((name, *cells, percent(gait.contact_share), MISSING, MISSING), "reference")


def _loop_cells(group: Sequence[Candidate]) -> tuple[str, ...]:
    runs = [each.closed_loop.run for each in group]
    alive = sum(run.alive for run in runs)
    lived = min(run.lived_seconds for run in runs)
    told = ("yes" if alive else "no") if len(runs) == 1 else f"{alive} of {len(runs)}"
    if lived < runs[0].seconds:
        told += f", {lived:.0f} s"

    def of(figure: Figure) -> float | None:
        return middle(group, figure)

    return (
        group[0].label,
        significant(median(map(score_of, group))),
        told,
        significant(of(lambda each: each.closed_loop.run.moving.speed_error)),
        significant(of(lambda each: each.closed_loop.run.moving.facing_error)),
        significant(of(lambda each: each.closed_loop.run.moving.limb_speed)),
        percent(of(lambda each: each.closed_loop.run.moving.frozen_share)),
        significant(of(lambda each: each.closed_loop.run.all.skate_speed)),
        significant(of(lambda each: each.closed_loop.run.all.slowest_foot_speed)),
        percent(of(lambda each: each.closed_loop.run.all.contact_share)),
        percent(of(lambda each: each.closed_loop.run.all.bone_drift)),
        percent(of(lambda each: each.closed_loop.run.largest_bone_drift), 0),
    )


def _kind_cells(kind: KindResult | None) -> tuple[str, ...]:
    if kind is None:
        return (MISSING,) * 4
    figures = (kind.speed, kind.facing_error, kind.limb_speed, kind.slowest_foot_speed)
    return tuple(significant(figure) for figure in figures)
