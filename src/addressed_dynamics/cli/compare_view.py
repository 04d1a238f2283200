"""What `addressed-dynamics compare` shows in a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from rich.console import Group, RenderableType
from rich.text import Text

from addressed_dynamics.cli.terminal import column_table, fact_grid, safe_text
from addressed_dynamics.comparing.comparison import Change, Comparison, ErrorChange
from addressed_dynamics.comparing.words import interval_words, shown, times
from addressed_dynamics.evaluation.common.bootstrap import COVERAGE
from addressed_dynamics.reporting.common.numbers import significant

NARROW = 100
"""With fewer columns, tables become lists."""
FEW = 20
"""So many changes of a kind are listed; the page has all of them."""
CODE = 8
"""So many parts of the code are named."""


def comparison_view(comparison: Comparison, width: int) -> RenderableType:
    """Return all that changed, in tables or, where the terminal is narrow, in lists."""
    return Group(*_parts(comparison, narrow=width < NARROW))


def _parts(comparison: Comparison, *, narrow: bool) -> Iterator[RenderableType]:
    yield safe_text(comparison.experiment, style="bold")
    yield fact_grid({"A": comparison.first.what, "B": comparison.second.what})
    yield safe_text(comparison.verdict)
    for note in comparison.notes:
        yield safe_text(note, style="yellow")
    moved = tuple(each for each in comparison.figures if each.first != each.second)
    for title, changes in (("Params", comparison.params), ("Data", comparison.data), ("Figures", moved)):
        if changes:
            yield Text("")
            yield _change_list(title, changes) if narrow else _change_table(title, changes)
            if len(changes) > FEW:
                yield safe_text(f"and {len(changes) - FEW} more: --json or -o FILE has all", style="dim")
    if comparison.code:
        names = [each.name if each.name != "commit" else f"{each.first} → {each.second}" for each in comparison.code]
        more = f" and {len(names) - CODE} more" if len(names) > CODE else ""
        yield safe_text(f"Code that differs: {', '.join(names[:CODE])}{more}")
    if same := len(comparison.figures) - len(moved):
        yield safe_text(f"Figures that are the same: {same}")
    others = tuple(each for each in comparison.candidates if each.said != "the same")
    for title, errors in (("Recommended model", comparison.errors), ("All models", others)):
        if errors:
            yield Text("")
            yield _error_list(title, errors) if narrow else _error_table(title, errors)
    if alike := len(comparison.candidates) - len(others):
        yield safe_text(f"Errors of all models that are the same: {alike}")
    for how in sorted({each.how for each in (*comparison.errors, *comparison.candidates)}):
        yield safe_text(f"Intervals ({100 * COVERAGE:g} %, over test episodes, not over seeds): {how}", style="dim")


def _change_table(title: str, changes: Sequence[Change]) -> RenderableType:
    table = column_table(title, A=True, B=True)
    for each in changes[:FEW]:
        table.add_row(*map(safe_text, (each.name, shown(each.first), shown(each.second))))
    return table


def _change_list(title: str, changes: Sequence[Change]) -> RenderableType:
    lines = [safe_text(f"{each.name}: {shown(each.first)} → {shown(each.second)}") for each in changes[:FEW]]
    return Group(safe_text(title, style="bold"), *lines)


def _error_table(title: str, errors: Sequence[ErrorChange]) -> RenderableType:
    table = column_table(title, error=False, A=True, B=True, ratio=True, interval=True, B_is=False)
    table.columns[0].no_wrap, table.columns[-1].no_wrap = False, True
    for each in errors:
        cells = (each.model, each.measure, significant(each.first), significant(each.second))
        table.add_row(*map(safe_text, (*cells, times(each.ratio), interval_words(each.ratio), each.said)))
    return table


def _error_list(title: str, errors: Sequence[ErrorChange]) -> RenderableType:
    lines = [
        safe_text(
            f"{each.model}, {each.measure}: {significant(each.first)} → {significant(each.second)}, "
            f"× {times(each.ratio)} ({interval_words(each.ratio)}): {each.said}"
        )
        for each in errors
    ]
    return Group(safe_text(title, style="bold"), *lines)
