"""Pages of the reference: the command line, the params and the names of the front door, as the code has them."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import typer

import addressed_dynamics
from addressed_dynamics.cli.main import app
from addressed_dynamics.cli.params_view import params_lines

PROGRAM = "addressed-dynamics"
RECORDED = "mountaincar"
"""Experiment of params.yaml that is shown as an example: it has keys that have no default."""


def cli_page() -> str:
    """Return the reference of the command line."""
    group: Any = typer.main.get_command(app)
    return "\n".join(_cli_lines(group)) + "\n"


def params_page(params_file: Path) -> str:
    """Return the reference of the params of both kinds of data, with an example from `params_file`."""
    return "\n".join(_params_lines(params_file)) + "\n"


def api_page() -> str:
    """Return the reference of what `from addressed_dynamics import …` offers, which mkdocstrings fills in."""
    lines = ["# API", "", "What `from addressed_dynamics import …` offers.", ""]
    for name in sorted(addressed_dynamics.__all__, key=str.lower):
        lines += [f"::: {addressed_dynamics.__name__}.{name}", ""]
    return "\n".join(lines)


def _cli_lines(group: Any) -> Iterator[str]:
    yield from (
        "# Command line",
        "",
        f"Every command says the same with `--help`. `{PROGRAM} --version` prints the version.",
    )
    for name, command in sorted(group.commands.items()):
        arguments = [each for each in command.params if each.param_type_name == "argument"]
        options = [each for each in command.params if each.param_type_name == "option"]
        shown = [each.metavar or each.name.upper() for each in arguments]
        yield from ("", f"## {name}", "", " ".join((command.help or "").split()), "")
        yield from ("```text", " ".join([PROGRAM, name, *(["[OPTIONS]"] if options else []), *shown]), "```")
        context = command.make_context(name, [], resilient_parsing=True)
        rows = [(text, each.help or "") for text, each in zip(shown, arguments, strict=True)]
        rows += [each.get_help_record(context) for each in options]
        if rows:
            yield from ("", "| | |", "| --- | --- |")
        yield from (f"| `{_cell(text)}` | {_cell(escape(' '.join(meaning.split())))} |" for text, meaning in rows)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _params_lines(params_file: Path) -> Iterator[str]:
    yield from ("# Params", "")
    yield f"What a section of params.yaml may have, with its defaults; `{PROGRAM} params NAME` prints those of"
    yield "your own experiments. A section in which nothing is changed is `{}`. The keys of `source` are on"
    yield "[a page of their own](../source-keys.md)."
    with TemporaryDirectory() as folder:
        bare = Path(folder, "params.yaml")
        bare.write_text("arm: {title: Arm}\nwalker: {title: Walker}\n", encoding="utf-8")
        for name, kind in (("arm", "transitions"), ("walker", "motion")):
            yield from ("", f"## All defaults: {kind}", "", "```yaml", *params_lines(bare, name, kind), "```")
    yield from (
        "",
        f"## An example: {RECORDED}",
        "",
        f"`{PROGRAM} params {RECORDED}`, with the keys of a recording.",
        "",
    )
    yield from ("```yaml", *params_lines(params_file, RECORDED, None), "```")
