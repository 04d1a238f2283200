"""The command line, for what is not a stage of the pipeline."""

import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer

from addressed_dynamics.errors import AddressedDynamicsError
from addressed_dynamics.logs import RecoveryReport, recover_log

app = typer.Typer(
    help="Learned simulators from logs of an agent.", no_args_is_help=True, pretty_exceptions_enable=False
)


def main() -> None:
    """Run the command line; an error is one line on stderr and exit status 1, Ctrl-C is exit status 130."""
    try:
        app()
    except AddressedDynamicsError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"addressed-dynamics {version('addressed-dynamics')}")
        raise typer.Exit


@app.callback()
def _options(
    _version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def recover(
    source: Annotated[
        Path, typer.Argument(metavar="IN", help="A log that is damaged or unfinished; it stays as it is.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="OUT", help="The new log; <name>.recovered.mcap by default."),
    ] = None,
) -> None:
    """Write a new log of all that is intact in a damaged or unfinished one."""
    report = recover_log(source, output or _recovered_path(source))
    for line in _recovery_lines(report):
        print(line)


@app.command()
def ui(port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the web page.")] = 5000) -> None:
    """Browse the runs in MLflow's user interface until Ctrl-C."""
    # MLflow takes seconds to import, and no other command needs it.
    from addressed_dynamics.tracking import serve_ui

    serve_ui(port)


def _recovered_path(source: Path) -> Path:
    stem = source.name.removesuffix(".partial").removesuffix(".mcap")
    return source.with_name(f"{stem}.recovered.mcap")


def _recovery_lines(report: RecoveryReport) -> list[str]:
    cut = f", {report.cut_episodes} of them cut" if report.cut_episodes else ""
    lines = [f"{report.target}: {report.transitions} transitions of {report.episodes} episodes{cut}"]
    lines += [f"lost: byte {loss.offset} {loss.reason} ({loss.size} bytes skipped)" for loss in report.losses]
    if report.transitions_missing:
        lines.append(f"lost: at least {report.transitions_missing} transitions between those that were saved")
    return lines
