"""Measures that have no section of their own: each is a table, under what its author says of it."""

from collections.abc import Sequence
from pathlib import Path

from addressed_dynamics.evaluation.common.measures import MEASURES, Row, read_rows_of_measures
from addressed_dynamics.reporting.common.blocks import Block, Column, Table
from addressed_dynamics.reporting.common.blocks import Row as Line
from addressed_dynamics.reporting.common.numbers import MISSING, significant


def further_measures(evaluation: Path) -> tuple[Block, ...]:
    """Return those measures in the folder of an evaluation that no section of a kind's own shows.

    Raises:
        EvaluationError: the table of measures is missing or damaged.
    """
    rows = [row for row in read_rows_of_measures(evaluation / MEASURES) if row.meaning]
    measures = dict.fromkeys(row.measure for row in rows)
    return tuple(_table([row for row in rows if row.measure == measure]) for measure in measures)


def _table(rows: Sequence[Row]) -> Table:
    quantities = dict.fromkeys((row.quantity, row.statistic, row.unit) for row in rows)
    values = {(row.candidate, row.quantity, row.statistic, row.unit): row.value for row in rows}
    columns = [Column(*_heading(*quantity)) for quantity in quantities]
    lines = [
        Line((name, *(_cell(values.get((name, *quantity))) for quantity in quantities)))
        for name in dict.fromkeys(row.candidate for row in rows)
    ]
    caption = f"{rows[0].measure.replace('_', ' ')}: {rows[0].meaning}"
    return Table(caption, (Column("Model", numeric=False), *columns), tuple(lines))


def _heading(quantity: str, statistic: str, unit: str) -> tuple[str, str]:
    words = [word.replace("_", " ") for word in (quantity, statistic) if word]
    return words[0], ", ".join([*words[1:], *([unit] if unit else [])])


def _cell(value: float | None) -> str:
    return MISSING if value is None else significant(value)
