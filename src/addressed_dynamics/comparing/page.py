"""A comparison as one HTML file, of the blocks that reports are made of."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from addressed_dynamics.base.files import why_not_file, write_text
from addressed_dynamics.comparing.comparison import Change, Comparison, ErrorChange
from addressed_dynamics.comparing.versions import ComparisonError
from addressed_dynamics.comparing.words import interval_words, shown, times
from addressed_dynamics.evaluation.common.bootstrap import COVERAGE, DRAWS
from addressed_dynamics.reporting.common.blocks import Block, Column, Facts, Report, Row, Section, Table, Text
from addressed_dynamics.reporting.common.numbers import significant
from addressed_dynamics.reporting.common.render import render_html

HOW = (
    f"The ratio is the second error in multiples of the first, with the interval that holds {100 * COVERAGE:g} % of "
    f"{DRAWS:,} draws of test episodes, the same ones for both where both were judged on the same. Where it holds 1, "
    "other test episodes could turn the comparison round, and neither is called better; of another training from other "
    "seeds it says nothing."
)
"""What the intervals are."""


def check_page(path: Path) -> None:
    """Check that a page can be written there: to be asked before the comparison, which takes a while.

    Raises:
        ComparisonError: it cannot.
    """
    if (problem := why_not_file(path)) is not None:
        message = f"{path}: {problem}"
        raise ComparisonError(message)


def write_page(comparisons: Sequence[Comparison], path: Path) -> None:
    """Write the comparisons into an HTML file that loads nothing from elsewhere.

    Raises:
        ComparisonError: the file cannot be written.
    """
    try:
        write_text(path, render_html(page(comparisons)))
    except OSError as error:
        message = f"{path}: the comparison cannot be written ({error.strerror or error})"
        raise ComparisonError(message) from error


def page(comparisons: Sequence[Comparison]) -> Report:
    """Return the comparisons of two versions, one section for each part of an experiment."""
    first, second = comparisons[0].first, comparisons[0].second
    several = len(comparisons) > 1
    parts = [
        Section(f"{each.experiment}: {title}" if several else title, blocks)
        for each in comparisons
        for title, blocks in _sections(each)
    ]
    return Report(
        title=f"{first.name} and {second.name}",
        subtitle=", ".join(each.experiment for each in comparisons),
        verdict=" ".join(each.verdict for each in comparisons),
        front=None,
        sections=(Section("In short", tuple(_in_short(comparisons))), *parts),
    )


def _in_short(comparisons: Sequence[Comparison]) -> Iterator[Block]:
    """Yield the errors of the recommended models in all experiments, what is compared, and what is missing."""
    several = len(comparisons) > 1
    errors = [
        ((f"{each.experiment}: {change.measure}" if several else change.measure,), change)
        for each in comparisons
        for change in each.errors
    ]
    if errors:
        models = [f"{each.experiment}: {each.errors[0].model}" for each in comparisons if each.errors]
        caption = f"Errors of the recommended models ({'; '.join(models)})."
        yield _error_table(caption, (Column("Error", numeric=False),), errors)
    yield Facts({"A": comparisons[0].first.what, "B": comparisons[0].second.what})
    notes = tuple(f"{each.experiment}: {note}" if several else note for each in comparisons for note in each.notes)
    if notes:
        yield Text(notes)


def _error_table(
    caption: str, names: tuple[Column, ...], errors: Sequence[tuple[tuple[str, ...], ErrorChange]]
) -> Table:
    """Return errors in two versions by their names; what follows from them stands first, so that it is never cut."""
    columns = (
        *names, Column("B is", numeric=False), Column("B / A"), Column(f"{100 * COVERAGE:g} %"), Column("A"),
        Column("B"),
    )  # fmt: skip
    rows = [
        Row((*name, each.said, times(each.ratio), interval_words(each.ratio), significant(each.first),
             significant(each.second)))
        for name, each in errors
    ]  # fmt: skip
    how = sorted({each.how for _, each in errors})
    return Table(f"{caption} {HOW} Here: {'; '.join(how)}." if how else caption, columns, tuple(rows))


def _sections(each: Comparison) -> Iterator[tuple[str, tuple[Block, ...]]]:
    defaults = "Keys that differ, those at their defaults included; the defaults are of the version installed here."
    yield "Params", (_changes(defaults, each.params, "All params are the same."),)
    digests = "What DVC has of the data (the first digits of digests), and counts of rows and episodes that differ."
    yield "Data", (_changes(digests, each.data, "The data are the same."),)
    code = "Code that the stages depend on and that differs: it may change figures though params and data are the same."
    yield "Code", (_changes(code, each.code, "The code of the stages is the same."),)
    figures = "Figures of the evaluation. They are single numbers, so there is no interval: of errors, see below."
    yield "Figures", (_changes(figures, each.figures, "No figure of both is known."),)
    if each.candidates:
        names = Column("Model", numeric=False), Column("Error", numeric=False)
        rows = [((change.model, change.measure), change) for change in each.candidates]
        yield "All models", (_error_table("Models that both versions have.", names, rows),)


def _changes(caption: str, changes: Sequence[Change], nothing: str) -> Block:
    if not changes:
        return Text((nothing,))
    columns = (Column("", numeric=False), Column("A"), Column("B"), Column("B − A"))
    rows = tuple(Row((each.name, shown(each.first), shown(each.second), _difference(each))) for each in changes)
    if all(not row.cells[3] for row in rows):
        return Table(caption, columns[:3], tuple(Row(row.cells[:3]) for row in rows))
    return Table(caption, columns, rows)


def _difference(change: Change) -> str:
    values = change.first, change.second
    if any(isinstance(each, bool) or not isinstance(each, int | float) for each in values):
        return ""
    difference = change.second - change.first
    return f"{difference:+.4g}" if difference else "0"
