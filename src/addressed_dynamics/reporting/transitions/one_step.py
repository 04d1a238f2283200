"""The delivered model one step ahead, dimension by dimension, beside what it is held against."""

from __future__ import annotations

from addressed_dynamics.evaluation.transitions.records import Evaluation
from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.figures.style import with_unit
from addressed_dynamics.reporting.common.numbers import MISSING, scientific
from addressed_dynamics.reporting.transitions.front import beside, title_of


def one_step_beside(evaluation: Evaluation) -> Table:
    """Return the mean and the 99th percentile of the absolute errors, in units."""
    names = beside(evaluation).names
    columns = (
        Column("Error one step ahead", numeric=False),
        *(Column(title_of(evaluation, name), group) for group in ("mean", "99th percentile") for name in names),
    )
    rows = []
    for each in evaluation.chosen.one_step.dimensions:
        found = [
            next((other for other in evaluation.candidates[name].one_step.dimensions if other.name == each.name), None)
            for name in names
        ]
        cells = [
            MISSING if other is None else scientific(getattr(other.absolute, share))
            for share in ("mean", "p99")
            for other in found
        ]
        rows.append(Row((with_unit(each.name, each.unit), *cells)))
    caption = (
        f"Absolute errors one step ahead, in units, on {evaluation.test.transitions:,} transitions of "
        f"{evaluation.test.episodes:,} held-out episodes."
    )
    return Table(caption, columns, tuple(rows))
