"""The report's tables."""

from __future__ import annotations

from collections.abc import Mapping

from addressed_dynamics.evaluation.transitions.records import AddressingResult, Evaluation, MemberResult, NoiseFloor
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.candidates import (
    COSTS,
    Effort,
    candidate_columns,
    candidate_row,
    costless_row,
    effort_of,
)
from addressed_dynamics.reporting.common.numbers import (
    MISSING,
    as_printed,
    count,
    listed,
    millionths,
    percent,
    scientific,
    significant,
)
from addressed_dynamics.reporting.transitions.paper import PaperFigures
from addressed_dynamics.reporting.transitions.recorded import DataResult
from addressed_dynamics.reporting.transitions.rollout_tables import dropped_words, median_mse, row_kind

HINDSIGHT = (
    "Hindsight picks the best of several guesses with knowledge of the truth: what it makes of the members bounds what "
    "addressing can reach, and says something of them only beside what it makes of as many random guesses with the "
    "members' mean and spread in every transition."
)
"""What a caption says of the lines of hindsight."""
NOISE_FLOOR = "noise floor of the data (nearest neighbours)"
"""What a reader should see for it."""
VARIANTS = {"plain": "with plain cross-entropy", "cost_sensitive": "that sees costly choices more often"}
"""How the variants of an addressing network are trained."""


def exogenous_table(data: DataResult) -> Table:
    """Return the exogenous inputs, at least one, with their ranges."""
    columns = (
        Column("Input", numeric=False),
        Column("unit", numeric=False),
        Column("lowest"),
        Column("highest"),
        Column("bounds", numeric=False),
        Column("role", numeric=False),
    )
    rows = [
        Row(
            (
                name,
                each.unit or MISSING,
                f"{each.min:.4g}",
                f"{each.max:.4g}",
                f"{_bound(each.low)} to {_bound(each.high)}",
                "exogenous: known, not predicted",
            )
        )
        for name, each in data.exogenous.items()
    ]
    caption = (
        "The exogenous inputs: what acts on the world and is known. A network is given their values beside the action "
        "of the same step, and is never asked for them; rollouts replay those that were recorded."
    )
    return Table(caption, columns, tuple(rows))


def _bound(bound: float | None) -> str:
    return "none" if bound is None else f"{bound:.4g}"


def paper_table(evaluation: Evaluation, paper: PaperFigures | None) -> Table:
    """Return the addressed ensemble's Table 1, beside the paper's if there is one."""
    columns = (
        Column("Network", numeric=False),
        Column("selected", "mean loss, 10⁻⁶"),
        Column("not selected", "mean loss, 10⁻⁶"),
        Column("per thousand", "misclassified"),
        Column("median", "their loss, 10⁻⁶"),
        Column("mean", "their loss, 10⁻⁶"),
        Column("max", "their loss, 10⁻⁶"),
    )
    rows = [
        Row(
            (
                f"the paper, network {index}",
                *(as_printed(loss, 1e-6) for loss in (network.selected, network.not_selected)),
                as_printed(network.misclassified_per_thousand),
                *(as_printed(loss, 1e-6) for loss in (network.median, network.mean, network.highest)),
            ),
            "reference",
        )
        for index, network in enumerate(paper.networks if paper else (), start=1)
    ]
    where = "here, network" if rows else "network"
    rows += [_member_row(f"{where} {k}", member) for k, member in enumerate(evaluation.table.members, start=1)]
    which = (
        "Table 1 of the paper, and the same for the addressed ensemble"
        if paper and paper.networks
        else "The addressed ensemble"
    )
    caption = (
        f"{which} (seed {evaluation.delivered.seed}, "
        f"{evaluation.delivered.variant.replace('_', '-')} addressing) on {evaluation.table.samples:,} transitions of "
        f"{evaluation.test.episodes:,} held-out episodes: {evaluation.loss.upper()} of states scaled to [0, 1] of "
        "each network on the points for which the addressing network selects it, and on the others; and the points "
        "for which it is selected although another network is better, per thousand of all points. The numbering is "
        "arbitrary."
    )
    return Table(caption, columns, tuple(rows))


def _member_row(title: str, member: MemberResult) -> Row:
    wrong = member.misclassified
    losses = map(millionths, (wrong.median, wrong.mean, wrong.max)) if wrong.per_thousand else (MISSING,) * 3
    cells = (title, millionths(member.selected), millionths(member.not_selected), significant(wrong.per_thousand))
    return Row((*cells, *losses), "own")


def variants_table(evaluation: Evaluation) -> Table:
    """Return the variants of addressing that were trained side by side, for every seed."""
    columns = (
        Column("Addressing", numeric=False),
        Column("agreement"),
        Column("misclassified, ‰"),
        Column("mean", "regret"),
        Column("p99", "regret"),
        Column("max", "regret"),
        *(Column(f"network {k + 1}", "share of samples") for k in range(len(evaluation.table.members))),
    )
    rows = [
        Row(
            (f"{variant.replace('_', '-')}, seed {seed}", *_addressing_cells(table)),
            "own" if (int(seed), variant) == (evaluation.delivered.seed, evaluation.delivered.variant) else "",
        )
        for seed, tables in evaluation.seeds.items()
        for variant, table in tables.items()
    ]
    trained = {variant for tables in evaluation.seeds.values() for variant in tables}
    which = [words for variant, words in VARIANTS.items() if variant in trained]
    caption = (
        f"The addressing network {' and the one '.join(which)}, on the same held-out transitions. Agreement: share "
        "for which the best network is selected. Regret: loss of the selected network minus loss of the best, over all "
        "transitions. The one that the report is about stands out."
    )
    return Table(caption, columns, tuple(rows))


def _addressing_cells(table: AddressingResult) -> tuple[str, ...]:
    regret = (scientific(value) for value in (table.regret.mean, table.regret.p99, table.regret.max))
    shares = (percent(member.share) for member in table.members)
    return (percent(table.agreement), significant(table.misclassified_per_thousand), *regret, *shares)


def confusion_table(table: AddressingResult) -> Table:
    """Return how often each network is the best and which one is selected then."""
    members = range(1, len(table.members) + 1)
    columns = (Column("Best", numeric=False), *(Column(f"network {k}", "selected") for k in members))
    rows = [Row((f"network {k}", *map(count, row))) for k, row in zip(members, table.confusion, strict=True)]
    caption = f"Confusion of the addressing network: counts of {table.samples:,} held-out transitions."
    return Table(caption, columns, tuple(rows))


def one_step_table(evaluation: Evaluation, efforts: Mapping[str, Effort], paper: PaperFigures | None) -> Table:
    """Return the costs and the one-step errors of all candidates.

    Args:
        evaluation: what was measured.
        efforts: how long each baseline was trained, by its name, and the ensemble as `ensemble`.
        paper: what the paper reports of these data; None if nothing.
    """
    dimensions = evaluation.own.one_step.dimensions
    columns = candidate_columns(
        *(Column(name, f"{evaluation.loss.upper()}, scaled states") for name in ("mean", "median", "p99", "max")),
        *(
            Column(f"{each.name}, {each.unit}" if each.unit else each.name, "mean absolute error")
            for each in dimensions
        ),
    )
    rows = []
    for name, candidate in evaluation.candidates.items():
        scaled = candidate.one_step.scaled
        errors = [scaled.mean, scaled.median, scaled.p99, scaled.max]
        errors += [each.absolute.mean for each in candidate.one_step.dimensions]
        rows.append(candidate_row(candidate, effort_of(efforts, name), map(scientific, errors), row_kind(name)))
    if floor := evaluation.noise_floor:
        known = [
            scientific(floor.absolute[each.name]) if each.name in floor.absolute else MISSING for each in dimensions
        ]
        rows.append(costless_row(NOISE_FLOOR, [scientific(floor.scaled), *[MISSING] * 3, *known], "reference"))
    caption = (
        f"One step ahead, all candidates on the same {evaluation.test.transitions:,} held-out transitions. "
        f"{HINDSIGHT} {COSTS}."
    )
    if evaluation.noise_floor:
        caption += f" {noise_words(evaluation.noise_floor)}"
    if evaluation.test.dropped.episodes:
        caption += f" Left out: {dropped_words(evaluation.test.dropped)} for the history that networks are given."
    if paper and paper.wide_network_fails and (wide := evaluation.baseline("wide")):
        caption += (
            " One network of three layers of 512 is the paper's own comparison, which it says was unable to learn the "
            f"dynamics; here it is '{wide[0].label}'."
        )
    return Table(caption, columns, tuple(rows))


def noise_words(floor: NoiseFloor) -> str:
    """Say how the noise floor was found."""
    return (
        f"The noise floor is what differs between steps that begin alike: {floor.transitions:,} of these transitions, "
        f"each beside its {floor.neighbours} nearest among {floor.among:,} training transitions, as their distance "
        "goes to zero (the gamma test). It is an estimate and no bound: where the data are thin, or the world jumps, "
        "as at a stop, that is no noise, and a model may be below it."
    )


def seed_table(evaluation: Evaluation, delivered: Mapping[str, str]) -> Table:
    """Return the spread over seeds of the ensembles, with the delivered addressing of each."""
    candidates = evaluation.own_seeds
    names = list(evaluation.own.rollouts.all.mse) if evaluation.own.rollouts else []
    columns = (
        Column("Seed", numeric=False),
        Column("mean", "one step, scaled states"),
        Column("median", "one step, scaled states"),
        *(Column(name, "rollouts, median MSE") for name in names),
        Column("agreement"),
        Column("misclassified, ‰"),
    )
    rows = []
    for seed, candidate in zip(evaluation.seeds, candidates, strict=True):
        table = evaluation.seeds[seed][delivered[seed]]
        cells = [seed, scientific(candidate.one_step.scaled.mean), scientific(candidate.one_step.scaled.median)]
        cells += [median_mse(candidate.rollouts.all, name) if candidate.rollouts else MISSING for name in names]
        cells += [percent(table.agreement), significant(table.misclassified_per_thousand)]
        rows.append(Row(tuple(cells), "own" if seed == str(evaluation.delivered.seed) else ""))
    return Table(
        "Spread over seeds: from each, one ensemble and the addressing network chosen for it on validation episodes.",
        columns,
        tuple(rows),
    )


def segment_table(data: DataResult, judged: int, history: int) -> Table:
    """Return what was recorded; how many episodes ended inside the task, if an agent learned to end them.

    Args:
        data: what was converted.
        judged: test transitions that models were judged on.
        history: frames that a model is given; the first transitions of an episode have fewer.
    """
    learned = any(segment.behaviour == "dqn" for segment in data.segments.values())
    columns = [
        Column("Segment", numeric=False),
        Column("behaviour", numeric=False),
        Column("transitions"),
        Column("episodes"),
    ]
    rows = [[name, each.behaviour, count(each.transitions), count(each.count)] for name, each in data.segments.items()]
    splits = listed(
        [f"{each.episodes:,} ({each.transitions:,} transitions) for {name}" for name, each in data.splits.items()]
    )
    kept_whole = "Blocks and the episodes without any" if data.blocks and data.blocks.blocks else "Episodes"
    caption = f"What was recorded. {kept_whole} are kept whole when the data is split: {splits}"
    caption += f", {judged:,} of them with the {history} frames that a model is given." if history > 1 else "."
    if learned:
        columns.append(Column("ended inside the task, at most the last 100"))
        for row, segment in zip(rows, data.segments.values(), strict=True):
            row.append(percent(segment.terminated_share_last_100, 0))
        caption += (
            " Inside the task an episode ends where its environment says so (terminated), as at a goal; some never do."
        )
    return Table(caption, tuple(columns), tuple(Row(tuple(row)) for row in rows))
