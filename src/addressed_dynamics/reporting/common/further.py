"""Measures that have no section of their own: each is a table, under what its author says of it."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from addressed_dynamics.evaluation.common.measures import MEASURES, Row, read_rows_of_measures
from addressed_dynamics.reporting.common.blocks import Block, Column, Table
from addressed_dynamics.reporting.common.blocks import Row as Line
from addressed_dynamics.reporting.common.numbers import MISSING, scientific, significant

_NOTHING = 0.005
"""What is less of a per cent is shown as none."""


def further_measures(evaluation: Path, titles: Mapping[str, str] | None = None) -> tuple[Block, ...]:
    """Return those measures in the folder of an evaluation that no section of a kind's own shows.

    Args:
        evaluation: the folder.
        titles: what the candidates are called in the report, by their names; the names where it does not say.

    Raises:
        EvaluationError: the table of measures is missing or damaged.
    """
    rows = [row for row in read_rows_of_measures(evaluation / MEASURES) if row.meaning]
    measures = dict.fromkeys(row.measure for row in rows)
    return tuple(_table([row for row in rows if row.measure == measure], titles or {}) for measure in measures)


def _table(rows: Sequence[Row], titles: Mapping[str, str]) -> Table:
    quantities = dict.fromkeys((row.quantity, row.statistic, row.unit) for row in rows)
    values = {(row.candidate, row.quantity, row.statistic, row.unit): row.value for row in rows}
    columns = [Column(*_heading(*quantity)) for quantity in quantities]
    lines = [
        Line((titles.get(name, name), *(_cell(values.get((name, *each)), each[2]) for each in quantities)))
        for name in dict.fromkeys(row.candidate for row in rows)
    ]
    caption = f"{rows[0].measure.replace('_', ' ').capitalize()}: {rows[0].meaning}"
    return Table(caption, (Column("Model", numeric=False), *columns), tuple(lines))


def _heading(quantity: str, statistic: str, unit: str) -> tuple[str, str]:
    words = [word.replace("_", " ") for word in (quantity, statistic) if word]
    return words[0], ", ".join([*words[1:], *([unit] if unit else [])])


def _cell(value: float | None, unit: str) -> str:
    if value is None:
        return MISSING
    if unit == "%":
        return significant(value) if abs(value) >= _NOTHING else "0"
    return scientific(value, 3)
