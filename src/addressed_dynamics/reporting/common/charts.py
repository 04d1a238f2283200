"""A chart as the numbers that the page draws, and as a table for those who cannot see it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from addressed_dynamics.reporting.common.blocks import Chart, Column, Line, Row, Table, View
from addressed_dynamics.reporting.common.numbers import MISSING, count, scientific, significant

DIGITS = 4
"""Significant digits that a chart keeps of a number."""
MOST_PLACES = 120
"""Places along a chart's axis: more could not be told apart."""
MOST_SHOWN = 3
"""Lines that a chart shows at first."""
_PLAIN = 1e-3
"""A place along an axis is a power of ten if it is smaller."""
_TOLD = 5
"""Places of which the table of a chart has the values."""


def rounded(value: float | None) -> float | None:
    """Return a number with as many digits as a chart keeps; None for what is no number."""
    return None if value is None or not np.isfinite(value) else float(f"{value:.{DIGITS - 1}e}")


def numbers(values: Iterable[float]) -> tuple[float | None, ...]:
    """Return the values of a line, rounded."""
    return tuple(rounded(float(value)) for value in values)


def places_of(steps: Float[np.ndarray, " place"]) -> list[int]:
    """Return which of so many places a chart keeps: all of the first, and fewer and fewer later on."""
    if len(steps) <= MOST_PLACES:
        return list(range(len(steps)))
    even = np.linspace(0, len(steps) - 1, MOST_PLACES // 2)
    early = np.geomspace(1, len(steps), MOST_PLACES // 2) - 1
    kept: list[int] = np.unique(np.concatenate([even, early]).round().astype(np.int64)).tolist()
    return kept


def chart_json(chart: Chart) -> str:
    """Return a chart as JSON that can stand inside a script element."""
    places = list(dict.fromkeys(view.places for view in chart.views))
    document = {
        "name": chart.name,
        "label": chart.label,
        "logarithmic": chart.logarithmic,
        "form": chart.form,
        "height": chart.height,
        "alternative": chart.alternative,
        "choices": chart.choices,
        "places": [[rounded(place) for place in each] for each in places],
        "views": [_view(view, places.index(view.places)) for view in chart.views],
    }
    # A page must not find the end of the script in a name.
    return json.dumps(document, ensure_ascii=False, separators=(",", ":")).replace("<", "\\u003c")


def _view(view: View, places: int) -> dict[str, Any]:
    level = {} if view.level is None else {"level": rounded(view.level)}
    return {
        "choice": view.choice,
        "label": view.label,
        "logarithmic": view.logarithmic,
        "places": places,
        "lines": [_line(line) for line in view.lines],
        **level,
    }


def _line(line: Line) -> dict[str, Any]:
    band = {"low": [*map(rounded, line.low)], "high": [*map(rounded, line.high)]} if line.low else {}
    values = [rounded(value) for value in line.values]
    return {
        "name": line.name, "colour": line.colour, "style": line.style, "shown": line.shown, "values": values, **band
    }  # fmt: skip


def value_table(chart: Chart) -> Table:
    """Return some of the values that a chart shows at first."""
    view = chart.views[0]
    chosen = f" ({', '.join(view.choice)})" if view.choice else ""
    caption = f"{view.label}{chosen}"
    if chart.form == "ranges":
        ends = (Column("", numeric=False), Column("low"), Column("middle"), Column("high"))
        rows = [
            Row((line.name, *(", ".join(map(_cell, each)) or MISSING for each in (line.low, line.values, line.high))))
            for line in view.lines
        ]
        return Table(caption, ends, tuple(rows))
    lines = [line for line in view.lines if line.shown and _known(line)]
    told = _told(len(view.places), [_known(line) for line in lines])
    heads = _heads([view.places[each] for each in told])
    rows = [Row((line.name, *(_cell(line.values[each]) for each in told))) for line in lines]
    return Table(caption, (Column(chart.label, numeric=False), *map(Column, heads)), tuple(rows))


def _known(line: Line) -> list[int]:
    """Return at which places a line has a value."""
    return [place for place, value in enumerate(line.values) if value is not None]


def _told(places: int, known: Sequence[list[int]]) -> list[int]:
    """Return the places that a table tells of: some of all, and some of a line that would have next to none there."""
    if places <= _TOLD:
        return list(range(places))
    told = set(_spread(range(places), _TOLD))
    for own in known:
        if len(told & set(own)) < 2:
            told |= set(_spread(own, 3))
    return sorted(told)


def _spread(places: Sequence[int], number: int) -> list[int]:
    """Return so many of these places, from the first to the last."""
    return [places[round(each)] for each in np.linspace(0, len(places) - 1, number).tolist()]


def _heads(places: Sequence[float]) -> list[str]:
    if all(float(place).is_integer() for place in places):
        return [count(place) for place in places]
    return [significant(place) if place == 0 or abs(place) >= _PLAIN else scientific(place) for place in places]


def _cell(value: float | None) -> str:
    return MISSING if value is None else scientific(value)
