"""What a report is made of: plain values that the HTML and the Markdown template both understand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    header: str
    """Its title."""
    group: str = ""
    """Title over this column and its neighbours of the same group; empty for none."""
    numeric: bool = True
    """Whether its cells are numbers, which are aligned to the right."""


@dataclass(frozen=True)
class Row:
    """One row of a table."""

    cells: tuple[str, ...]
    """Its text, one for each column."""
    kind: str = ""
    """How it stands out: `own` for what the report is about, `reference` for what it is compared with, `reached` or
    `missed` for what was wanted, or not at all."""


@dataclass(frozen=True)
class Table:
    """A table with its caption."""

    caption: str
    """What the table shows and over what data; one or more sentences."""
    columns: tuple[Column, ...]
    """Columns in order; the first names the row."""
    rows: tuple[Row, ...]
    """Rows in order."""
    stacked: bool = False
    """Whether its cells stand below each other on a narrow screen, so that the last is seen; else the table scrolls."""
    kind: str = "table"
    """Which of the blocks this is, for the templates."""

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """Titles over neighbouring columns with the number of columns under each; empty if no column has one."""
        spans: list[tuple[str, int]] = []
        for column in self.columns:
            if spans and spans[-1][0] == column.group:
                spans[-1] = (column.group, spans[-1][1] + 1)
            else:
                spans.append((column.group, 1))
        return tuple(spans) if any(title for title, _ in spans) else ()


@dataclass(frozen=True)
class Panel:
    """One picture of a figure."""

    name: str
    """Name of its file, without suffix; unique in the report."""
    alternative: str
    """What a reader who cannot see it should know."""
    content: bytes
    """The picture, as a file of `format`."""
    width: int
    """Width at which it is to be shown, in CSS pixels."""
    height: int
    """Height at which it is to be shown, in CSS pixels."""
    format: Literal["png", "gif"] = "png"
    """Its format, which is also the suffix of its file."""
    still: bytes | None = None
    """A PNG in place of a picture that moves, for readers who want no motion; None if it does not move."""


@dataclass(frozen=True)
class Figure:
    """Pictures that belong together, with their caption."""

    caption: str
    """What one sees and over what data."""
    panels: tuple[Panel, ...]
    """Pictures side by side, or below each other where there is no room."""
    kind: str = "figure"
    """Which of the blocks this is, for the templates."""


@dataclass(frozen=True)
class Facts:
    """A short list of names and values."""

    items: Mapping[str, str]
    """Value by name."""
    kind: str = "facts"
    """Which of the blocks this is, for the templates."""


@dataclass(frozen=True)
class Links:
    """Files and folders beside the report."""

    items: Mapping[str, str]
    """Address by name, relative to the report."""
    kind: str = "links"
    """Which of the blocks this is, for the templates."""


@dataclass(frozen=True)
class Text:
    """Paragraphs."""

    paragraphs: tuple[str, ...]
    """Plain text."""
    kind: str = "text"
    """Which of the blocks this is, for the templates."""


@dataclass(frozen=True)
class Line:
    """What one model, or the truth, has in a chart."""

    name: str
    """What a reader should see for it."""
    colour: str
    """Its colour, as `#rrggbb`."""
    values: tuple[float | None, ...]
    """One for each place of the view, or a single one in a chart of ranges; None where there is none."""
    low: tuple[float | None, ...] = ()
    """Lower end of the band around the line; empty, like the next, for none."""
    high: tuple[float | None, ...] = ()
    """Its upper end."""
    style: Literal["line", "dashed", "thick", "points", "area"] = "line"
    """How it is drawn."""
    shown: bool = True
    """Whether it is there at first; the others can be asked for."""


@dataclass(frozen=True)
class View:
    """What a chart shows at a time."""

    choice: tuple[str, ...]
    """What is chosen, one for each of the chart's `choices`."""
    label: str
    """What the vertical axis shows, with its unit; in a chart of ranges the horizontal one."""
    places: tuple[float, ...]
    """Where the values are along the horizontal axis, rising; empty in a chart of ranges."""
    lines: tuple[Line, ...]
    """What is drawn, the most important first."""
    logarithmic: bool = True
    """Whether the axis of the values is."""
    level: float | None = None
    """A value with a line of its own, for instance a limit."""


@dataclass(frozen=True)
class Chart:
    """A chart that the page draws from its numbers, so that they can be read off."""

    name: str
    """Unique in the report."""
    caption: str
    """What one sees and over what data."""
    alternative: str
    """What a reader who cannot see it should know."""
    label: str
    """What the horizontal axis shows, with its unit."""
    views: tuple[View, ...]
    """What it can show; the first is there at first. All have the same form."""
    choices: tuple[str, ...] = ()
    """What can be chosen, for instance `dimension`; empty if there is one view."""
    logarithmic: bool = False
    """Whether the horizontal axis is."""
    form: Literal["lines", "ranges"] = "lines"
    """Lines over an axis, or one range with its middle below the other."""
    height: int = 270
    """Its height in CSS pixels."""
    kind: str = "chart"
    """Which of the blocks this is, for the templates."""


@dataclass(frozen=True)
class Fold:
    """Details that are folded away until a reader asks for them, or prints the page."""

    title: str
    """What is in it."""
    blocks: tuple[Table | Figure | Facts | Links | Text | Chart, ...]
    """What it holds, in order."""
    kind: str = "fold"
    """Which of the blocks this is, for the templates."""


Block = Table | Figure | Facts | Links | Text | Chart | Fold


@dataclass(frozen=True)
class Front:
    """What stands on the first screen: which model, how good it is, and how far to trust it."""

    answers: Mapping[str, str]
    """Which model, and for how long it can be trusted; a few words each."""
    load: str
    """The line of Python that loads it."""
    sentences: tuple[str, ...]
    """What else has to be said at once; with the captions six sentences at most."""
    errors: Table | None = None
    """How large its errors are, beside those of others; None if that was not measured."""
    film: Figure | None = None
    """What its predictions look like; None if nobody can see such states."""
    chart: Chart | None = None
    """Its error over time; None if that was not measured."""
    missing: tuple[str, ...] = ()
    """What should stand here but was not measured, each with the command that does."""


NOTHING = Front(answers={}, load="", sentences=())
"""A first screen of which nothing is known."""


@dataclass(frozen=True)
class Section:
    """A part of the report."""

    title: str
    """Its heading."""
    blocks: tuple[Block, ...]
    """What it holds, in order."""
    folded: bool = False
    """Whether it can be folded away, so that only its heading is there; on paper all is there."""
    opened: bool = False
    """Whether one that can be is unfolded at first."""

    @property
    def anchor(self) -> str:
        """Name of the section in addresses."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


@dataclass(frozen=True)
class Report:
    """A whole report."""

    title: str
    """Its heading."""
    subtitle: str
    """One line below it."""
    verdict: str
    """The result in one or two sentences."""
    front: Front | None
    """What stands on the first screen; None for the verdict alone."""
    sections: tuple[Section, ...]
    """The rest."""

    @property
    def blocks(self) -> tuple[Block, ...]:
        """All that is not folds, whether or not it is in one, in order; what stands on the first screen comes first."""
        front = () if self.front is None else (self.front.errors, self.front.film, self.front.chart)
        inside = [block for section in self.sections for block in section.blocks]
        unfolded = [each for block in inside for each in (block.blocks if isinstance(block, Fold) else (block,))]
        return (*(block for block in front if block is not None), *unfolded)

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All pictures, in order."""
        figures = [block for block in self.blocks if isinstance(block, Figure)]
        return tuple(panel for figure in figures for panel in figure.panels)

    @property
    def charts(self) -> tuple[Chart, ...]:
        """All charts, in order."""
        return tuple(block for block in self.blocks if isinstance(block, Chart))


@dataclass(frozen=True)
class Card:
    """What stands in the folder of an experiment's models. It is a function of what was measured: it has no date."""

    title: str
    """Its heading."""
    subtitle: str
    """One line below it."""
    verdict: str
    """The result in one or two sentences."""
    load: tuple[str, ...]
    """Lines of Python that load the model and ask it."""
    sections: tuple[Section, ...] = ()
    """The rest."""
