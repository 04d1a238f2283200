"""The command line, for what is not a stage of the pipeline."""

import atexit
import gc
import json
import sys
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console, RenderableType

from addressed_dynamics.base.errors import AddressedDynamicsError, ParamsError
from addressed_dynamics.base.params.editing import add_experiment, check_free, remove_experiment
from addressed_dynamics.cli.import_view import assessment_view, look_view, proposal_view
from addressed_dynamics.cli.inspection import Inspection, inspect_file, is_of_logs, log_files
from addressed_dynamics.cli.new import (
    MAPPINGS,
    ask,
    predictions_words,
    recorded_logs,
    section_text,
    source_lines,
    try_import,
    usable_lengths,
    what_to_say,
    yaml_text,
)
from addressed_dynamics.cli.params_view import params_lines
from addressed_dynamics.cli.project import VERSION_FILE, make_project, renew_project
from addressed_dynamics.cli.source_keys import source_keys
from addressed_dynamics.cli.terminal import file_view, folder_view
from addressed_dynamics.cli.verdicts import verdict_lines
from addressed_dynamics.importing.finding import check_there, find_logs
from addressed_dynamics.importing.proposing import Wishes
from addressed_dynamics.logs import RecoveryReport, recover_log

PIPE_WIDTH = 120
"""Width of tables where there is no terminal that would say how wide it is."""
EXTRAS = dict.fromkeys(("dvc", "matplotlib", "mlflow", "PIL", "stable_baselines3", "tqdm"), "pipeline")
"""Which extra of this package brings a module that not every installation has."""

app = typer.Typer(
    help="Learned simulators from logs of an agent.", no_args_is_help=True, pretty_exceptions_enable=False
)


def main() -> None:
    """Run the command line; an error is one line on stderr and exit status 1, Ctrl-C is exit status 130."""
    # Else Python's last search for garbage goes through all of PyTorch, for most of a second.
    atexit.register(gc.freeze)
    try:
        app()
    except AddressedDynamicsError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    except ModuleNotFoundError as error:
        if error.name is None or (extra := EXTRAS.get(error.name.partition(".")[0])) is None:
            raise
        needed = f"this needs '{error.name}': pip install 'addressed-dynamics[{extra}]'"
        print(f"error: {needed}", file=sys.stderr)
        sys.exit(1)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"addressed-dynamics {_version()}")
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


Paths = Annotated[list[Path], typer.Argument(metavar="PATH…", help="Logs or tables of any kind, or folders of them.")]
Rate = Annotated[float | None, typer.Option(help="Steps in a second.")]
Reward = Annotated[str | None, typer.Option(metavar="FIELD", help="The reward of a step.")]
Ends = Annotated[str | None, typer.Option(metavar="FIELD|file|end|reset", help="Where episodes end.")]
Types = Annotated[list[str] | None, typer.Option(metavar="PATH", help="Definitions (.msg) that logs do not carry.")]
Fields = Annotated[list[str] | None, typer.Option(metavar="[NAME=]FIELD", help="Repeat it for several fields.")]


@app.command()
def inspect(
    paths: Paths,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")] = False,
    observation: Fields = None,
    action: Fields = None,
    exogenous: Fields = None,
    reward: Reward = None,
    rate: Rate = None,
    episode: Ends = None,
    types: Types = None,
) -> None:
    """Show what is in logs and what can be imported of them; the exit status is 1 if one of them is damaged."""
    wishes = _wishes(observation, action, exogenous, reward, rate, episode, types)
    document, views, damaged = _inspected(paths, wishes)
    if as_json:
        print(json.dumps(document, indent=2))
    else:
        console = _console()
        for view in views:
            console.print(view, crop=False)
    if damaged:
        raise typer.Exit(1)


@app.command()
def init(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder; it is made if it is not there.")],
    renew: Annotated[
        bool, typer.Option("--renew", help="Write dvc.yaml and pipeline/ of a project anew, of this version.")
    ] = False,
) -> None:
    """Write a project of your own: the stages, a params file without experiments, and what DVC and Git need."""
    if renew:
        renew_project(folder)
        print(f"{folder / 'dvc.yaml'} and {folder / VERSION_FILE.partition('/')[0]} are of version {_version()}")
        print("next: dvc repro; what is of another version is made anew")
        return
    with_git = make_project(folder)
    print(
        f"{folder} is a project: README.md says what is next{'; a Git repository was made there' if with_git else ''}"
    )
    if find_spec("dvc") is None:
        print("its stages need more than is installed: pip install 'addressed-dynamics[pipeline]'")
    print(f"next: cd {folder} && addressed-dynamics new NAME path/to/logs")


@app.command()
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What the experiment is called.")],
    paths: Paths,
    observation: Fields = None,
    action: Fields = None,
    exogenous: Fields = None,
    reward: Reward = None,
    rate: Rate = None,
    episode: Ends = None,
    types: Types = None,
    predictions: Annotated[
        bool,
        typer.Option("--predictions", help="Learn also from logs of what a model predicted, as a drive leaves them."),
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", help="Ask nothing; take what is guessed.")] = False,
    file: Annotated[Path, typer.Option("--params", help="The params file.")] = Path("params.yaml"),
) -> None:
    """Make an experiment of somebody's logs: look at them, write its section into the params file, say what is next."""
    check_free(file, name, MAPPINGS)  # to look at many logs takes a while
    console = _console()
    found = find_logs(paths)
    recorded = recorded_logs(found)
    if recorded is not None:
        # Logs of transitions are what an import would make.
        _allow_predictions(recorded.predicted, predictions=predictions, may_ask=not yes)
        entries = {"experiments": f"{{kind: transitions, raw: {yaml_text(found.folder)}}}"}
        _add(file, name, entries, section_text(name, (), recorded.lengths, predictions=bool(recorded.predicted)))
        return
    wishes = _wishes(observation, action, exogenous, reward, rate, episode, types)
    trial = try_import(paths, wishes)
    console.print(look_view(trial.look), crop=False)
    if trial.proposal.unknown and not yes and sys.stdin.isatty():
        wishes = ask(trial.look, trial.proposal, wishes, typer.prompt)
        trial = try_import(paths, wishes)
    if trial.assessment is None:
        message = f"{', '.join(map(str, paths))}: {what_to_say(trial)}"
        raise ParamsError(message)
    for view in (proposal_view(trial.proposal), assessment_view(trial.assessment)):
        console.print(view, crop=False)
    if trial.assessment.refusal is not None:
        raise ParamsError(trial.assessment.refusal)
    if not trial.assessment.transitions:
        message = f"{', '.join(map(str, paths))}: no episode is worth training on; see the reasons above"
        raise ParamsError(message)
    if not yes and sys.stdin.isatty() and not typer.confirm(f"Write this to {file}?", default=True):
        raise typer.Exit(1)
    imported = yaml_text(trial.found.dependency)
    entries = {"experiments": f"{{kind: transitions, raw: data/raw/{name}}}", "imported": imported}
    section = section_text(name, source_lines(trial.proposal), usable_lengths(trial.assessment))
    _add(file, name, entries, section)


@app.command()
def remove(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An experiment that 'new' made.")],
    yes: Annotated[bool, typer.Option("--yes", help="Also one that somebody wrote by hand.")] = False,
    file: Annotated[Path, typer.Option("--params", help="The params file.")] = Path("params.yaml"),
) -> None:
    """Take an experiment out of the params file; its data and models stay where they are."""
    remove_experiment(file, name, MAPPINGS, of_anybody=yes)
    print(f"{name} is no longer in {file}; what was made for it is still in data")


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


@app.command("source-keys")
def print_source_keys() -> None:
    """Print what the section `source` of an experiment may have: every key of every kind, in Markdown."""
    print(source_keys(), end="")


@app.command()
def trust(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An experiment with models, or a model folder.")],
    logs: Annotated[Path, typer.Argument(metavar="LOGS", help="Logs or tables of transitions, or a folder of them.")],
    candidate: Annotated[str | None, typer.Option(help="Which model; the delivered one by default.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of a table.")] = False,
) -> None:
    """Say how far a model is to be trusted on logs, and whether what they record is still what was modelled."""
    # PyTorch takes a second to import, and no other command needs it.
    from addressed_dynamics.cli.judging_logs import judge_logs, trust_view
    from addressed_dynamics.simulators.delivery import find_models

    found = judge_logs(find_models(name), logs, candidate)
    if as_json:
        print(json.dumps({"episodes": [each.to_json() for each in found]}, indent=2))
    else:
        _console().print(trust_view(logs, found), crop=False)


@app.command()
def export(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An experiment with models, or a model folder.")],
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The file: NAME.onnx or NAME.pt2.")],
    file_format: Annotated[
        str | None, typer.Option("--format", metavar="onnx|pt2", help="Its format; by its name if left out.")
    ] = None,
    candidate: Annotated[str | None, typer.Option(help="Which model; the delivered one by default.")] = None,
    seed: Annotated[int | None, typer.Option(help="Which of its seeds.")] = None,
    variant: Annotated[str | None, typer.Option(help="Which of its addressing networks.")] = None,
    mode: Annotated[str | None, typer.Option(help="How it uses its members.")] = None,
) -> None:
    """Write the step of a model as one graph, for ONNX Runtime or torch.export, and compare what it gives."""
    # PyTorch takes seconds to import.
    from addressed_dynamics.simulators.delivery import find_models
    from addressed_dynamics.simulators.exporting import export_model

    done = export_model(
        find_models(name), output, file_format, candidate=candidate, seed=seed, variant=variant, mode=mode
    )
    shapes = ", ".join(f"{each} ({', '.join(shape)})" for each, shape in done.inputs.items())
    print(f"{done.path}: {shapes}; B is the batch")
    print(f"for {done.rows:,} inputs it differs from predict by at most {done.difference:.1e} of the range")


@app.command()
def compare(
    first: Annotated[
        str,
        typer.Argument(metavar="A", help="A commit, branch, tag or DVC experiment, 'workspace', or a run in MLflow."),
    ],
    second: Annotated[str, typer.Argument(metavar="B", help="What it is compared with.")] = "workspace",
    experiment: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Only this experiment; repeat it for several.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON document instead of tables.")] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="Write it as one HTML file, too.")
    ] = None,
) -> None:
    """Say what differs between two versions of experiments: params, data, code and figures, with intervals."""
    from addressed_dynamics.cli.compare_view import comparison_view
    from addressed_dynamics.comparing.asking import compare_all
    from addressed_dynamics.comparing.page import check_page, write_page

    if output is not None:
        check_page(output)
    found = compare_all(first, second, experiment or ())
    if output is not None:
        write_page(found, output)
    if as_json:
        print(json.dumps({"comparisons": [each.to_json() for each in found]}, indent=2))
        return
    console = _console()
    for each in found:
        console.print(comparison_view(each, console.width), crop=False)
    if output is not None:
        print(f"all of it is in {output}")


@app.command()
def verdicts(
    names: Annotated[list[str] | None, typer.Argument(metavar="[NAME]...", help="Experiments; all by default.")] = None,
    file: Annotated[Path, typer.Option("--params", help="The params file.")] = Path("params.yaml"),
) -> None:
    """Print what was found of each experiment and where its report is, one line each."""
    for line in verdict_lines(file, names or ()):
        print(line)


@app.command()
def ui(port: Annotated[int, typer.Option(min=1, max=65535, help="Port of the web page.")] = 5000) -> None:
    """Browse the runs in MLflow's user interface until Ctrl-C."""
    if find_spec("mlflow") is None:  # it is run, and not imported
        raise ModuleNotFoundError(name="mlflow")
    # MLflow takes seconds to import, and no other command needs it.
    from addressed_dynamics.tracking import serve_ui

    serve_ui(port)


@app.command()
def drive(
    name: Annotated[str, typer.Argument(metavar="NAME", help="An experiment with models, or a model folder.")],
    port: Annotated[int | None, typer.Option(min=0, max=65535, help="Port of the page; 0 for any.")] = None,
    candidate: Annotated[str | None, typer.Option(help="Which model; the delivered one by default.")] = None,
    environment: Annotated[
        str | None, typer.Option(metavar="ID", help="The Gymnasium environment that is modelled, if it is not found.")
    ] = None,
    record_to: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Where recordings go; data/driven/NAME by default.")
    ] = None,
    seed: Annotated[
        int | None, typer.Option(min=0, max=2**32, help="Of the first start; by chance by default.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "--params", metavar="FILE", help="The params file that has the experiment; params.yaml if there is one."
        ),
    ] = None,
) -> None:
    """Drive a model by hand in a page on 127.0.0.1, beside the truth where there is an environment, until Ctrl-C."""
    # PyTorch and aiohttp take seconds to import, and no other command needs both.
    from addressed_dynamics.cli.driving import drive_in_page

    drive_in_page(name, file, port=port, candidate=candidate, environment=environment, record_to=record_to, seed=seed)


def _version() -> str:
    return version("addressed-dynamics")


def _allow_predictions(predicted: list[Path], *, predictions: bool, may_ask: bool) -> None:
    """Go on if no log holds predictions, or if they are wanted, as was said or as whoever is asked says.

    Raises:
        ParamsError: they are not.
    """
    if not predicted or predictions:
        return
    words = predictions_words(predicted)
    if may_ask and sys.stdin.isatty() and typer.confirm(f"{words}; learn from them all the same?", default=False):
        return
    message = f"{words}; leave such logs out, or say --predictions"
    raise ParamsError(message)


def _add(file: Path, name: str, entries: dict[str, str], section: str) -> None:
    add_experiment(file, name, entries, section)
    print(f"{name} stands in {file}, for you to change; 'addressed-dynamics remove {name}' takes it out again")
    print(f"next: dvc repro report@{name}")


def _wishes(
    observation: list[str] | None,
    action: list[str] | None,
    exogenous: list[str] | None,
    reward: str | None,
    rate: float | None,
    episode: str | None,
    types: list[str] | None,
) -> Wishes:
    fields = {"observation": observation, "action": action, "exogenous": exogenous}
    return Wishes(**{role: tuple(wished or ()) for role, wished in fields.items()},
                  reward=reward, rate_hz=rate, episode=episode, types=tuple(types or ()))  # fmt: skip


def _console() -> Console:
    return Console(width=None if sys.stdout.isatty() else PIPE_WIDTH, highlight=False)


def _inspected(paths: list[Path], wishes: Wishes) -> tuple[dict[str, Any], list[RenderableType], bool]:
    """Return what there is as JSON-compatible values and for the terminal, and whether some of it is damaged."""
    document, views = dict[str, Any](), list[RenderableType]()
    for path in paths:
        check_there(path)
    path, logs = paths[0], is_of_logs(paths)
    if logs:
        inspection = Inspection(tuple(inspect_file(file) for path in paths for file in log_files(path)))
        one = len(paths) == 1 and not path.is_dir()
        document |= inspection.files[0].to_json() if one else inspection.to_json()
        views.append(file_view(inspection.files[0]) if one else folder_view(inspection, paths))
        if inspection.damaged or all(each.run is not None for each in inspection.files):
            return document, views, bool(inspection.damaged)
    trial = try_import(paths, wishes)
    views += [look_view(trial.look), proposal_view(trial.proposal)]
    views += [assessment_view(trial.assessment)] if trial.assessment else []
    return document | {"import": trial.to_json()}, views, False


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
