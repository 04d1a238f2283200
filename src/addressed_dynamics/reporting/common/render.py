"""The report as files: one HTML file that holds everything, and Markdown with its pictures beside it."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path

from jinja2 import Environment, PackageLoader, StrictUndefined, Template
from markupsafe import Markup

from addressed_dynamics.base.files import atomic_path, write_text
from addressed_dynamics.reporting.common.blocks import Card, Report
from addressed_dynamics.reporting.common.charts import chart_json, value_table

FIGURES = "figures"
"""Name of the folder of pictures beside the Markdown."""


def write_report(report: Report, folder: Path, beside: Callable[[Path], None] | None = None) -> None:
    """Write report.html, report.md and the folder of figures into `folder`; `beside` writes more into the last."""
    with atomic_path(folder / FIGURES) as pictures:
        pictures.mkdir()
        for panel in report.panels:
            (pictures / f"{panel.name}.{panel.format}").write_bytes(panel.content)
        if beside is not None:
            beside(pictures)
    write_text(folder / "report.md", render_markdown(report))
    write_text(folder / "report.html", render_html(report))


def render_html(report: Report) -> str:
    """Return the report as an HTML file that loads nothing from elsewhere."""
    environment = _environment(autoescape=True)
    environment.filters["data_uri"] = _data_uri
    environment.filters["chart_json"] = lambda chart: Markup(chart_json(chart))  # it has no markup
    return environment.get_template("report.html.j2").render(report=report)


def render_markdown(report: Report) -> str:
    """Return the report as Markdown that refers to the pictures in `FIGURES`."""
    return _markdown("report.md.j2").render(report=report, figures=FIGURES)


def render_card(card: Card) -> str:
    """Return a model card as Markdown."""
    return _markdown("card.md.j2").render(card=card, figures=FIGURES)


def _markdown(template: str) -> Template:
    environment = _environment(autoescape=False)
    environment.filters["cell"] = lambda text: text.replace("|", "\\|")
    return environment.get_template(template)


def _environment(*, autoescape: bool) -> Environment:
    environment = Environment(
        loader=PackageLoader("addressed_dynamics.reporting.common"),
        autoescape=autoescape,  # the Markdown twin is no HTML
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters["value_table"] = value_table
    return environment


def _data_uri(content: bytes, picture_format: str) -> str:
    return f"data:image/{picture_format};base64,{base64.b64encode(content).decode('ascii')}"
