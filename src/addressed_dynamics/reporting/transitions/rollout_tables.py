"""The report's tables of free-running rollouts."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.evaluation.common.records import Dropped
from addressed_dynamics.evaluation.transitions.falling import FALLEN
from addressed_dynamics.evaluation.transitions.physics import ROUNDING, TRUTH, TWIN
from addressed_dynamics.evaluation.transitions.records import (
    Evaluation,
    Falling,
    PhysicsResult,
    RolloutGroup,
    RolloutPhysics,
    RolloutResult,
    RolloutSource,
    SimulationResult,
)
from addressed_dynamics.evaluation.transitions.rollouts import FLOWN_WIDTHS, LEFT_BOUNDS_TOLERANCE
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.numbers import MISSING, listed, percent, scientific, significant
from addressed_dynamics.reporting.transitions.paper import PaperFigures

MOST_COLUMNS = 8
"""Errors that stand side by side; where there are more, each group of rollouts has a table of its own."""

FEW = f"They are fewer than {FEWEST_ROLLOUTS}: too few for percentiles, or to say that a model is better"
"""What is said of few rollouts."""


def rollout_tables(evaluation: Evaluation, paper: PaperFigures | None) -> tuple[Table, ...]:
    """Return the rollout errors of all candidates, beside the paper's if there are any."""
    own = evaluation.own.rollouts
    groups, names = (list(own.groups), list(own.all.mse)) if own else ([], [])
    if len(groups) * len(names) <= MOST_COLUMNS:
        return (_rollout_table(evaluation, paper, groups),)
    return tuple(_rollout_table(evaluation, paper, [group]) for group in groups)


def _rollout_table(evaluation: Evaluation, paper: PaperFigures | None, groups: list[str]) -> Table:
    own = evaluation.own.rollouts
    names = list(own.all.mse) if own else []
    bounded = own is not None and own.left_bounds_share is not None and groups[0] == "all"
    columns = [Column("Model", numeric=False)]
    if len(groups) > 1:
        columns += [Column(group_title(group), f"{name}, median MSE") for name in names for group in groups]
    else:
        columns += [Column(name, "median MSE") for name in names]
    columns += [Column("leave the bounds")] if bounded else []
    counted = own is not None and own.flown_off_share is not None and groups[0] == "all"
    columns += [Column("fly off")] if counted else []
    rows = []
    if paper and paper.rollouts and groups[0] == "all":
        cells = [_paper_mse(paper, name) if group == "all" else "" for name in names for group in groups]
        rows.append(Row(("the paper, one rollout figure", *cells, *[""] * (bounded + counted)), "reference"))
    for name, candidate in evaluation.candidates.items():
        if candidate.rollouts is None:
            continue
        cells = [median_mse(candidate.rollouts.groups[group], each) for each in names for group in groups]
        shares = [candidate.rollouts.left_bounds_share] * bounded + [candidate.rollouts.flown_off_share] * counted
        cells += ["0" if share == 0 else percent(share) for share in shares if share is not None]
        rows.append(Row((candidate.label, *cells), row_kind(name)))
    of_group = "" if "all" in groups else f", those from segment {group_title(groups[0])} alone"
    caption = (
        f"Free-running rollouts{_rollout_source(evaluation)}{of_group}: mean squared error of a whole rollout in the "
        "units of the state, median over rollouts"
    )
    if bounded:
        caption += (
            "; and the share of rollouts in which a predicted state leaves the bounds by more than "
            f"{percent(LEFT_BOUNDS_TOLERANCE, 0)} of their range"
        )
    if counted:
        caption += (
            "; and the share of rollouts that fly off: a predicted state lies outside of the range of the training "
            f"data by more than {FLOWN_WIDTHS:g} times its width, or is no number"
        )
    few = own is not None and not own.all.tells
    caption += f". {FEW}" * few
    return Table(f"{caption}.", tuple(columns), tuple(rows))


def lost_table(evaluation: Evaluation, physics: RolloutPhysics) -> Table:
    """Return the time until each model has lost the truth, beside what is possible at best."""
    end = evaluation.rollouts.steps * physics.step_seconds

    def cells(result: PhysicsResult, group: RolloutGroup) -> list[str]:
        lost = result.lost_seconds
        low, middle, high = (seconds(each, end) for each in (lost.p10, lost.median, lost.p90))
        spread = low if low == high else f"{low} to {high}"
        return [middle, spread if group.tells else MISSING, percent(lost.never_share, 0)]

    columns = ("median, s", "10% to 90%, s", "never")
    caption = (
        f"Time until the angle error passes {physics.angle_limit:g} rad in free-running rollouts of {end:g} s, of "
        f"whichever angle is off by more: median, 10th and 90th percentile over rollouts (of {FEWEST_ROLLOUTS} or "
        "more), and the share in which it never does. Fast swings of a double pendulum are chaotic. What is possible "
        "at best is in the first two lines: one true simulation beside the recording, from the recorded start, which "
        "is kept in single precision; and two true simulations beside each other whose first angles are "
        f"{scientific(physics.apart, 1)} rad apart at the start."
    )
    simulations = {name: each for name, each in physics.simulations.items() if name != TRUTH}
    return _physics_table(caption, columns, cells, evaluation, simulations)


def energy_table(evaluation: Evaluation, physics: RolloutPhysics) -> Table:
    """Return how well each model keeps to the true energy."""
    end = evaluation.rollouts.steps * physics.step_seconds

    def cells(result: PhysicsResult, _: RolloutGroup) -> list[str]:
        return [scientific(result.energy_error.median), scientific(result.energy_drift.median)]

    caption = (
        "Energy in free-running rollouts, median over rollouts: the mean difference from the true energy at the same "
        f"time, and how far the energy at the end, after {end:g} s, is from that at the start. Without torque the "
        "latter should be zero, but for the bounds of the velocities, where energy is lost, and the error of the "
        "integration: the recording itself shows how much that is. Hanging at rest and standing upright are "
        "39.2 J apart."
    )
    columns = ("error, J", "change, J")
    simulations = {name: each for name, each in physics.simulations.items() if name in {TRUTH, ROUNDING}}
    return _physics_table(caption, columns, cells, evaluation, simulations)


def _physics_table(
    caption: str,
    columns: tuple[str, ...],
    cells: Callable[[PhysicsResult, RolloutGroup], list[str]],
    evaluation: Evaluation,
    simulations: Mapping[str, SimulationResult],
) -> Table:
    """Return a table of so many columns for each group; those without episodes are empty."""
    own = evaluation.own.rollouts
    groups = list(own.groups) if own else []
    titles = [f"{group_title(group)} ({own.groups[group].number:,})" for group in groups] if own else []
    named: list[tuple[str, RolloutResult, str]] = [(each.label, each, "reference") for each in simulations.values()]
    named += [
        (each.label, each.rollouts, row_kind(name)) for name, each in evaluation.candidates.items() if each.rollouts
    ]
    rows = []
    for label, result, kind in named:
        found = [result.groups[group] for group in groups]
        inside = [
            cell for each in found for cell in (cells(each.physics, each) if each.physics else [MISSING] * len(columns))
        ]
        rows.append(Row((label, *inside), kind))
    over = titles if len(groups) > 1 else [""]
    heads = (Column("Model", numeric=False), *(Column(column, title) for title in over for column in columns))
    return Table(caption, heads, tuple(rows))


def lost_sentence(evaluation: Evaluation, physics: RolloutPhysics) -> str:
    """Say when the addressed ensemble loses the truth, beside two true simulations; empty if it was not measured."""
    end = evaluation.rollouts.steps * physics.step_seconds
    own = evaluation.own.rollouts.all.physics if evaluation.own.rollouts else None
    twin = physics.simulations[TWIN].all.physics
    if own is None or twin is None:
        return ""
    found, possible = (
        f"{'more than ' * (each.median is None)}{significant(end if each.median is None else each.median)} s"
        for each in (own.lost_seconds, twin.lost_seconds)
    )
    return (
        f"An angle is off by more than {physics.angle_limit:g} rad after {found} (median; in "
        f"{percent(own.lost_seconds.never_share, 0)} of the rollouts it never is); of two true simulations that start "
        f"{scientific(physics.apart, 1)} rad apart, after {possible}."
    )


def falling_words(falls: Falling) -> str:
    """Say why the errors of long rollouts fall, as far as what was counted says it."""
    then, end = falls.highest, falls.end
    steps = f"steps {then.first_step:,} to {then.last_step:,}"
    what = (
        f"The median error of the delivered model falls again, from {_error(then.percent)} of the range in {steps} to "
        f"{_error(end.percent)} in steps {end.first_step:,} to {end.last_step:,}."
    )
    now, before = (percent(each.held_share, 0) for each in (end, then))
    shares = f"{now} of the true states stand still or are at a bound by then ({before} in {steps})"
    others = f"all others are off by {_error(end.free_percent)} ({_error(then.free_percent)} in {steps})"
    if not rests(falls):
        return f"{what} That the world comes to rest does not explain it: {shares}; {others}."
    return (
        f"{what} No prediction got better by that: {shares}, where hardly anything is left to be missed (error "
        f"{_error(end.held_percent)}); {others}, which is what to expect of long rollouts on the move."
    )


def rests(falls: Falling) -> bool:
    """Return whether errors fall because much comes to rest: more of the states, which are off by less than others.

    It is not so if those that move are predicted better, too.
    """
    then, end = falls.highest, falls.end
    if end.held_share <= then.held_share or end.held_percent is None:
        return False
    if end.free_percent is None or then.free_percent is None:
        return end.held_percent < then.percent
    return end.held_percent < end.free_percent and end.free_percent >= FALLEN * then.free_percent


def _error(value: float | None) -> str:
    return "nothing that was measured" if value is None else f"{significant(value, 2)} %"


def group_title(name: str) -> str:
    """Return a group of rollouts as a reader should see it."""
    return name.replace("_", " ")


def median_mse(group: RolloutGroup, name: str) -> str:
    """Return the median error of a dimension of the state."""
    spread = group.mse.get(name)
    return MISSING if spread is None else scientific(spread.median)


def seconds(value: float | None, end: float) -> str:
    """Return a time in rollouts of so many seconds; None lies beyond their end."""
    return f"> {end:g}" if value is None else significant(value)


def row_kind(name: str) -> str:
    """Return how the row of a candidate stands out."""
    if name == "ensemble/argmax":
        return "own"
    return "" if name.startswith("ensemble/") else "reference"


def _paper_mse(paper: PaperFigures, name: str) -> str:
    return scientific(paper.rollouts[name].mse, 4) if name in paper.rollouts else MISSING


def _rollout_source(evaluation: Evaluation) -> str:
    rollouts, source = evaluation.own.rollouts, evaluation.rollouts
    if rollouts is None:
        return ""
    groups = rollouts.groups
    if source.kind == "environment":
        free, wall = (groups[name].number if name in groups else 0 for name in ("no_wall", "wall"))
        return f" ({rollouts.all.number:,} in all, {free:,} without and {wall:,} with wall contact)"
    parts = [f"{each.number:,} from {group_title(name)}" for name, each in groups.items() if name != "all"]
    segments = f", {listed(parts)}" if parts else ""
    stretches = f"{rollouts.all.number:,} stretches" if rollouts.all.number > 1 else "one stretch"
    exogenous = f" and the exogenous inputs ({listed(list(source.exogenous))})" if source.exogenous else ""
    return (
        f" beside {stretches} of {source.steps:,} steps from {episodes_words(rollouts.all)}{segments} (from the true "
        f"first state of each, under the actions{exogenous} recorded there{_shorter(source)}{_overlapping(source)})"
    )


def episodes_words(group: RolloutGroup) -> str:
    """Say in which episodes rollouts begin, and in how many, where that is known."""
    if group.rollouts is None:
        return "held-out episodes"
    return "one held-out episode" if group.episodes == 1 else f"{group.episodes:,} held-out episodes"


def _overlapping(source: RolloutSource) -> str:
    if not source.overlapping:
        return ""
    return (
        f"; fewer than {FEWEST_ROLLOUTS} would fit in one after the other, so they begin at equal distances and "
        "overlap; what is drawn for an interval is episodes"
    )


def dropped_words(dropped: Dropped) -> str:
    """Say how many held-out episodes are too short, at least one."""
    if dropped.episodes == 1:
        return f"one held-out episode of {dropped.rows:,} steps is too short"
    return f"{dropped.episodes:,} held-out episodes with together {dropped.rows:,} steps are too short"


def _shorter(source: RolloutSource) -> str:
    parts = [
        f"; there is none from {group_title(name)}, whose longest held-out episode has {longest:,} steps"
        for name, longest in source.too_short.items()
    ]
    if source.steps < source.steps_wanted:
        parts.insert(0, f"; the params file asks for {source.steps_wanted:,}, but no held-out episode is longer")
    if source.dropped.episodes:
        parts.append(f"; {dropped_words(source.dropped)} for a stretch")
    return "".join(parts)
