"""The command line, for what is not a stage of the pipeline."""

import json
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.cli.inspection import Inspection, inspect_file, log_files
from addressed_dynamics.cli.params_view import params_lines
from addressed_dynamics.cli.terminal import file_view, folder_view
from addressed_dynamics.logs import RecoveryReport, recover_log

PIPE_WIDTH = 120
"""Width of tables where there is no terminal that would say how wide it is."""

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
def inspect(
    path: Annotated[Path, typer.Argument(metavar="FILE|FOLDER", help="An MCAP file of any kind, or a folder of them.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")] = False,
) -> None:
    """Show what is in logs; the exit status is 1 if one of them is damaged."""
    inspection = Inspection(tuple(inspect_file(file) for file in log_files(path)))
    if as_json:
        print(json.dumps(inspection.to_json() if path.is_dir() else inspection.files[0].to_json(), indent=2))
    else:
        width = None if sys.stdout.isatty() else PIPE_WIDTH
        view = folder_view(inspection, path) if path.is_dir() else file_view(inspection.files[0])
        Console(width=width, highlight=False).print(view, crop=False)
    if inspection.damaged:
        raise typer.Exit(1)


@app.command()
def params(
    experiment: Annotated[str, typer.Argument(metavar="NAME", help="An experiment, a section of the params file.")],
    file: Annotated[Path, typer.Option("--params", help="The params file, or one that extends it.")] = Path(
        "params.yaml"
    ),
    kind: Annotated[str | None, typer.Option(help="Its kind of data, if the file does not say.")] = None,
) -> None:
    """Print every key of an experiment with its value and its meaning, those at their defaults included."""
    for line in params_lines(file, experiment, kind):
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
    (first, last), (begin, end) = report.saved_episodes, report.saved_time_ns
    lines = [
        f"{report.target}: {report.transitions} transitions of {report.episodes} episodes{cut}",
        f"saved: episodes {first} to {last}, {_seconds(begin)} to {_seconds(end)}",
        *(f"saved: {count} messages of {topic}" for topic, count in report.messages.items()),
        *(f"lost: byte {loss.offset} {loss.reason} ({loss.size} bytes skipped)" for loss in report.losses),
    ]
    for gap in report.gaps:
        (before, after), (left, right) = gap.episodes, gap.time_ns
        where = "the beginning" if before is None or left is None else f"episode {before} ({_seconds(left)})"
        lines.append(f"lost: {gap.transitions} transitions between {where} and episode {after} ({_seconds(right)})")
    dropped = report.transitions_missing - sum(gap.transitions for gap in report.gaps)
    if dropped:
        lines.append(f"lost: {dropped} transitions that follow a gap inside their episode")
    return lines


def _seconds(time_ns: int) -> str:
    return f"{time_ns / 1e9:.3f} s"
