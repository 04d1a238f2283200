"""Tables of errors one step ahead, of addressing, and of seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.motion.records import Candidate, MotionEvaluation, PhaseUse
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.candidates import (
    COSTS,
    Effort,
    candidate_columns,
    candidate_row,
    costless_row,
    effort_of,
)
from addressed_dynamics.reporting.common.numbers import MISSING, count, percent, significant
from addressed_dynamics.reporting.motion.models import OWN, UNTRAINED, main_models, model_style
from addressed_dynamics.reporting.motion.paper import PAPER_OWN, PAPER_PFNN, PAPER_ROWS
from addressed_dynamics.reporting.motion.recorded import SPLITS

LEAKY = "rows"
"""The split whose frames are near copies of what was trained on."""


PAPER_NOTE = (
    f"The paper's figures are those of {PAPER_ROWS:,} such frames of other data, in a unit that it does not state. "
)


def one_step_table(evaluation: MotionEvaluation, efforts: Mapping[str, Effort], *, paper: bool) -> Table:
    """Return the costs and the errors of all candidates one step ahead, on every held-out split.

    Args:
        evaluation: what was measured.
        efforts: how long each group was trained, and the ensemble as `ensemble`.
        paper: whether the paper's figures stand below.
    """
    splits = evaluation.held_out
    titles = [f"{SPLITS.get(split, split)}{' (near copies)' * (split == LEAKY)}" for split in splits]
    columns = candidate_columns(*(Column(name, f"MAE, {title}") for title in titles for name in ("raw", "normalised")))
    rows = []
    for name, group in evaluation.groups.items():
        cells = [
            _spread([getattr(each.one_step[split], unit) for each in group])
            for split in splits
            for unit in ("raw", "normalised")
        ]
        rows.append(candidate_row(group[0], effort_of(efforts, name), cells, row_kind(evaluation, name)))
    paper = paper and LEAKY in splits
    if paper:
        rows += [
            _paper_row("the paper: its model", PAPER_OWN, splits),
            _paper_row("the paper: PFNN", PAPER_PFNN, splits),
        ]
    sizes = "; ".join(
        f"{title} {evaluation.own.one_step[split].rows:,}" for split, title in zip(splits, titles, strict=True)
    )
    several = any(len(group) > 1 for group in evaluation.groups.values())
    caption = (
        "Mean absolute error of all 311 outputs one step ahead, raw (units mixed, as the paper has it) and in units "
        f"of each output's deviation. Frames: {sizes}. Only held-out clips tell what a model makes of motion that it "
        "has not seen: held-out frames lie between two frames that it was trained on, 1/60 s apart, and an error on "
        f"them is also one of memory. {PAPER_NOTE * paper}{COSTS}"
        f"{'; with several seeds, the errors are the median, and the lowest and the highest' * several}."
    )
    return Table(caption, columns, tuple(rows))


def block_table(evaluation: MotionEvaluation) -> Table:
    """Return the errors by block of outputs, on held-out clips: of all models in units that one can imagine.

    Results of earlier versions have not all of these units; of those it is the main models' mean absolute errors.
    """
    if evaluation.own.test.units:
        return _unit_table(evaluation)
    shown = {group: evaluation.candidates[name] for group, name in main_models(evaluation).items()}
    titles = [_short(group) for group in shown]
    columns = (
        Column("Outputs", numeric=False),
        Column("unit", numeric=False),
        Column("columns"),
        *(Column(title, "MAE in that unit") for title in titles),
        *(Column(title, "normalised MAE") for title in titles),
    )
    rows = []
    for index, block in enumerate(evaluation.own.test.blocks):
        found = [candidate.test.blocks[index] for candidate in shown.values()]
        raw, normalised = ([significant(getattr(each, unit)) for each in found] for unit in ("raw", "normalised"))
        cells = (block.block.replace("_", " "), block.unit or MISSING, count(block.columns), *raw, *normalised)
        rows.append(Row(cells))
    caption = (
        f"The same on held-out clips by block of outputs, seed {evaluation.delivered.seed}. The raw MAE is a mean over "
        "columns of different units, so positions in cm decide it; rotations are logarithms of quaternions in rad, "
        f"velocities are per frame at {FRAME_RATE} Hz."
    )
    return Table(caption, columns, tuple(rows))


def _unit_table(evaluation: MotionEvaluation) -> Table:
    units = {each.name: each.unit for each in evaluation.own.test.units}
    columns = (
        Column("Model", numeric=False),
        *(Column(f"{name.replace('_', ' ')}, {unit}") for name, unit in units.items()),
    )
    rows = []
    for group, candidates in evaluation.models.items():
        found = [{each.name: each.value for each in candidate.test.units} for candidate in candidates]
        cells = (significant(median([each[name] for each in found])) for name in units)
        rows.append(Row((model_style(group)[0], *cells), row_kind(evaluation, group)))
    several = any(len(group) > 1 for group in evaluation.models.values())
    caption = (
        f"One step ahead on {evaluation.own.test.rows:,} frames of held-out clips, block by block: how far positions "
        "are off, how long the difference of velocities is, by what angle headings and rotations are off, and the "
        "share of heels and toes that are said to touch the ground and do not, or the other way round; means over "
        f"joints and frames{', and the median over seeds' * several}."
    )
    return Table(caption, columns, tuple(rows))


def phase_table(evaluation: MotionEvaluation) -> Table:
    """Return what the choice of a network tells of the phase, by gait."""
    splits = {"training frames": evaluation.addressing.train, "held-out clips": evaluation.addressing.test}
    columns = (
        Column("Gait", numeric=False),
        *(
            Column(name, title)
            for title in splits
            for name in ("frames", "choice, bits", "on the phase", "by chance", "chance, 95 %")
        ),
    )
    gaits = dict.fromkeys(use.gait for each in splits.values() for use in each.phase_use)
    rows = []
    for gait in gaits:
        found = [next((use for use in each.phase_use if use.gait == gait), None) for each in splits.values()]
        cells = (gait, *(cell for use in found for cell in _phase_cells(use)))
        rows.append(Row(cells, "own" if gait == "all" else ""))
    caption = (
        "How much the choice of a network tells of the phase of the gait cycle: mutual information of the two as a "
        "share of the choice's entropy, 0 if they are independent and 100% if the phase decides. No network is given "
        "the phase. By chance: the same with phases shuffled within each gait, mean and 95th percentile. Over all "
        "gaits: means, weighted by frames. Frames follow each other in time, so being above chance proves less than "
        "with independent samples."
    )
    return Table(caption, columns, tuple(rows))


def seed_table(evaluation: MotionEvaluation) -> Table:
    """Return every seed of the ensemble and of the other networks."""
    columns = (
        Column("Model", numeric=False),
        Column("seed"),
        Column("raw", "MAE, held-out clips"),
        Column("normalised", "MAE, held-out clips"),
        Column("score", "closed loop"),
        Column("limbs, cm/s", "closed loop"),
        Column("alive", "closed loop", numeric=False),
    )
    rows = []
    for group, candidates in evaluation.models.items():
        rows += [
            Row(_seed_cells(group, each), "own" if each is evaluation.own else "")
            for each in candidates
            if group not in UNTRAINED
        ]
    several = max(len(candidates) for candidates in evaluation.models.values()) > 1
    caption = (
        "Every seed of every network." if several else "The only seed of every network: there is no spread to show."
    )
    return Table(caption, columns, tuple(rows))


def row_kind(evaluation: MotionEvaluation, group: str) -> str:
    """Return how a row of a group stands out."""
    if group == evaluation.own_group:
        return "own"
    return "reference" if group in UNTRAINED or group == "released" else ""


def _seed_cells(group: str, candidate: Candidate) -> tuple[str, ...]:
    run = candidate.closed_loop.run
    return (
        model_style(group)[0],
        MISSING if candidate.seed is None else str(candidate.seed),
        significant(candidate.test.raw),
        significant(candidate.test.normalised),
        significant(candidate.closed_loop.score),
        significant(run.moving.limb_speed),
        "yes" if run.alive else "no",
    )


def _phase_cells(use: PhaseUse | None) -> tuple[str, ...]:
    if use is None:
        return (MISSING,) * 5
    shares = (percent(share) for share in (use.information_share, use.chance_share, use.chance_share_p95))
    return (count(use.rows), f"{use.choice_bits:.2f}", *shares)


def _spread(values: Sequence[float]) -> str:
    text = significant(median(values))
    return text if len(values) == 1 else f"{text} ({significant(min(values))} – {significant(max(values))})"


def _paper_row(title: str, error: float, splits: Sequence[str]) -> Row:
    cells = [cell for split in splits for cell in ((f"{error:g}" if split == LEAKY else MISSING), MISSING)]
    return costless_row(title, cells, "reference", MISSING)


def _short(group: str) -> str:
    title = model_style(group)[0]
    short = {OWN: "ensemble", "PFNN, trained here": "PFNN", "one large network": "one network"}
    return short.get(title, {"parameters mixed by a gate": "gate"}.get(title, title))
