"""Something to be reached, and what was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from addressed_dynamics.reporting.common.blocks import Column, Row, Table
from addressed_dynamics.reporting.common.numbers import in_words


@dataclass(frozen=True)
class Target:
    """Something to be reached, and what was."""

    name: str
    """What is measured."""
    wanted: str
    """Bound with its origin."""
    found: str
    """What was measured."""
    met: bool | None
    """Whether it was reached; None if it could not be measured."""


def reached(targets: Sequence[Target]) -> int:
    """Return how many were reached."""
    return sum(target.met is True for target in targets)


def reached_words(targets: Sequence[Target], what: str = "targets") -> str:
    """Return how many were reached, as part of a sentence: `two of the five targets; one could not be measured`."""
    number, met = len(targets), reached(targets)
    unknown = sum(target.met is None for target in targets)
    how_many = f"all {in_words(number)}" if met == number else f"{in_words(met)} of the {in_words(number)}"
    rest = f"; {in_words(unknown)} could not be measured" if unknown else ""
    return f"{how_many} {what}{rest}"


def target_table(targets: Sequence[Target], caption: str) -> Table:
    """Return what was to be reached and what was."""
    words = {True: "reached", False: "missed", None: "open"}
    columns = (
        Column("Figure", numeric=False),
        Column("Target", numeric=False),
        Column("Here"),
        Column("", numeric=False),
    )
    rows = [Row((each.name, each.wanted, each.found, words[each.met]), words[each.met]) for each in targets]
    return Table(caption, columns, tuple(rows), stacked=True)
