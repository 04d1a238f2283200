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
    """How it stands out: `own` for what the report is about, `reference` for what it is compared with, or empty."""


@dataclass(frozen=True)
class Table:
    """A table with its caption."""

    caption: str
    """What the table shows and over what data; one or more sentences."""
    columns: tuple[Column, ...]
    """Columns in order; the first names the row."""
    rows: tuple[Row, ...]
    """Rows in order."""
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
class Text:
    """Paragraphs."""

    paragraphs: tuple[str, ...]
    """Plain text."""
    kind: str = "text"
    """Which of the blocks this is, for the templates."""


Block = Table | Figure | Facts | Text


@dataclass(frozen=True)
class Section:
    """A part of the report."""

    title: str
    """Its heading."""
    blocks: tuple[Block, ...]
    """What it holds, in order."""

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
    findings: tuple[str, ...]
    """The sentences that it rests on."""
    targets: Table
    """What was to be reached and what was."""
    sections: tuple[Section, ...]
    """The rest."""

    @property
    def panels(self) -> tuple[Panel, ...]:
        """All pictures, in order."""
        figures = [block for section in self.sections for block in section.blocks if isinstance(block, Figure)]
        return tuple(panel for figure in figures for panel in figure.panels)
