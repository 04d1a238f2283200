"""What the paper states of angles and velocities, beside what was measured; and specialists beside one network."""

from __future__ import annotations

from collections.abc import Mapping
from statistics import mean

from addressed_dynamics.evaluation.common.sizes import total_size
from addressed_dynamics.evaluation.transitions.records import CandidateResult, DimensionResult, Evaluation
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.candidates import (
    COSTS,
    Effort,
    candidate_columns,
    candidate_row,
    costless_row,
    effort_of,
)
from addressed_dynamics.reporting.common.numbers import MISSING, listed, power_of_ten, scientific
from addressed_dynamics.reporting.transitions.paper import AngleFigures


def claims_table(evaluation: Evaluation, angles: AngleFigures) -> Table:
    """Return the one-step errors of cosines, sines, angles and velocities beside those that the paper states."""
    columns = (
        Column("One step ahead", numeric=False),
        Column("unit", numeric=False),
        Column("the paper, about"),
        Column("mean", "absolute error here"),
        Column("median", "absolute error here"),
        Column("max", "absolute error here"),
        Column("mean square here"),
    )
    one_step = evaluation.own.one_step
    rows: list[Row] = []
    for title, names, stated in (
        ("cosines and sines", angles.direction_names, angles.direction_error),
        ("angles", angles.angle_names, angles.angle_error),
        ("velocities", angles.velocity_names, angles.velocity_error),
    ):
        found = one_step.named(names)
        rows.append(_error_row(f"{title}, together", found, power_of_ten(stated), "own"))
        rows += [_error_row(each.name, [each], "", "") for each in found]
    caption = (
        f"The errors that the paper states (Experiment 2), and those of the addressed ensemble on "
        f"{evaluation.test.transitions:,} held-out transitions. The paper does not say whether its errors are squared "
        "or absolute. Errors of angles are taken the short way round the circle; together: means over the dimensions, "
        "and the highest of their medians and maxima."
    )
    return Table(caption, columns, tuple(rows))


def _error_row(title: str, found: list[DimensionResult], stated: str, kind: str) -> Row:
    absolute = [each.absolute for each in found]
    cells = (
        mean(each.mean for each in absolute),
        max(each.median for each in absolute),
        max(each.max for each in absolute),
        mean(each.squared.mean for each in found),
    )
    return Row((title, found[0].unit, stated, *map(scientific, cells)), kind)


def specialists_table(evaluation: Evaluation, efforts: Mapping[str, Effort]) -> Table | None:
    """Return the errors of hard addressing and of one network as large as all of it, or as a member, from every seed.

    None without the former.

    The spread over the seeds of each follows in the last two rows. `efforts`: as `tables.one_step_table` has them.
    """
    single = evaluation.baseline("total_parameters")
    if not single or len(evaluation.table.members) < 2:
        return None
    member = evaluation.baseline("same_size")
    names = list(evaluation.own.rollouts.all.mse) if evaluation.own.rollouts else []
    columns = candidate_columns(
        Column("mean", f"one step, {evaluation.loss.upper()} of scaled states"),
        Column("median", f"one step, {evaluation.loss.upper()} of scaled states"),
        *(Column(name, "rollouts, median MSE") for name in names),
    )
    specialists = f"{len(evaluation.table.members)} specialists"
    rows = []
    for title, name, group, seeds, kind in (
        (specialists, "ensemble", evaluation.own_seeds, list(evaluation.seeds), "own"),
        ("one network", "total_parameters", single, evaluation.seeds_of("total_parameters"), "reference"),
        ("one like a member", "same_size", member, evaluation.seeds_of("same_size"), "reference"),
    ):
        if not group:
            continue
        errors = [_errors(each, names) for each in group]
        for seed, candidate, row in zip(seeds, group, errors, strict=True):
            effort = effort_of(efforts, f"{name}/seed-{seed}")
            rows.append(candidate_row(candidate, effort, map(scientific, row), "", title=f"{title}, seed {seed}"))
        spreads = [_spread([row[place] for row in errors]) for place in range(len(errors[0]))]
        rows.append(costless_row(f"{title}, lowest to highest", spreads, kind))
    seeds = [str(len(group)) for group in (evaluation.own_seeds, single, member) if group]
    caption = (
        f"Hard addressing of {specialists} beside one network of "
        f"{total_size(single[0].parameters, evaluation.own.parameters)}"
        f"{', and one as large as a member' * bool(member)}, trained for as many updates: every seed of each "
        f"({listed(seeds)}), on the same held-out episodes. {COSTS}."
    )
    return Table(caption, columns, tuple(rows))


def _errors(candidate: CandidateResult, names: list[str]) -> list[float | None]:
    scaled, rollouts = candidate.one_step.scaled, candidate.rollouts
    spreads = [rollouts.all.mse.get(name) if rollouts else None for name in names]
    return [scaled.mean, scaled.median, *(None if spread is None else spread.median for spread in spreads)]


def _spread(errors: list[float | None]) -> str:
    known = [error for error in errors if error is not None]
    return f"{scientific(min(known))} – {scientific(max(known))}" if known else MISSING
