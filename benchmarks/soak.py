"""Does it survive? Every stage is killed, its disk filled and MLflow taken away at random instants, again and again.

    python benchmarks/soak.py FOLDER --experiments mountaincar pendulum --figures docs/figures/soak.json

The pipeline of the tests, a minute long, runs once undisturbed in a new project below FOLDER. Then every stage is run
again from where it began and disturbed: killed with SIGKILL together with DVC and all of its workers, several times in
a row before it may end; one of its workers killed alone, or DVC alone; the file system full; the MLflow store removed,
locked, damaged, or its server killed or stopped. After each disturbance, and at more instants at which all processes
are held still, nothing half written may lie where a reader would take it for whole. Once the stage has ended, all of
`data` and dvc.lock have to be as after the undisturbed run, bit for bit, but for the time that raw logs and reports
hold. Between such rounds, two `dvc repro` run at once.

An instant is a share of the time that the stage takes at that moment, so that it does not matter what else the machine
does. The seed decides all draws. Filling the disk needs the right to mount a file system. `make bench` leaves this out.
"""

import argparse
import json
import math
import signal
import sys
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from functools import partial
from pathlib import Path
from typing import Any

from filelock import FileLock
from measuring import print_table
from soak_commands import commands_in, fork_servers_in, kill_all, workers_in
from soak_mlflow import Server
from soak_projects import Step
from soak_rooms import SmallRoom, may_mount, small_file_system
from soak_trials import Soak

RAW = {"mountaincar": "record", "pfnn": "record", "pendulum": "import"}
STAGES = (
    "convert", "train_ensemble", "train_addressing", "train_baselines", "evaluate", "train_policy", "report",
)  # fmt: skip
SHORT = {"pendulum": ("import",)}
"""Experiments that do not go through all stages here."""
TRACKED = STAGES[1:]
"""Stages that MLflow sees."""
KILLS_A_TURN = 2
"""Rounds of kills in a turn, in which there is one of everything else."""
ALONE = {
    "worker killed": workers_in,
    "fork server killed": fork_servers_in,
    "tracker killed": partial(commands_in, mark="multiprocessing.resource_tracker"),
}
"""Processes that are killed alone."""
COUNTS = ("disturbed", "looked", "ended", "faults")
"""What is counted of each stage and kind of disturbance."""
MOST_LINES = 12
"""So many of the lines that were said are kept for each kind."""
NOT_KEPT = ("WARNING: Process", "Stage '", "Data and pipelines", "If there are no")
"""How lines of DVC about its own locks and what it need not run begin."""


def steps_of(experiments: list[str]) -> list[Step]:
    """Return the stages of experiments, in the order in which they run."""
    return [Step(stage, name) for name in experiments for stage in SHORT.get(name, (RAW[name], *STAGES))]


def soak(found: Soak, options: argparse.Namespace, room: SmallRoom | None, server: Server) -> None:
    """Disturb all stages as often as was asked for, in turns; end when the time is over."""
    waiting = list[Iterator[None]]()
    for step in found.steps:
        if options.stages and step.stage not in options.stages:
            continue
        if step.experiment == "pfnn" and step.stage == "train_policy":
            continue  # it has none to train
        waiting += [found.kill(step, options.kills)] * KILLS_A_TURN
        for kind, victims in ALONE.items():
            waiting.append(found.kill_alone(step, options.alone, kind, victims))
        waiting.append(found.orphan(step, options.orphans))
        if room:
            waiting.append(found.fill(step, options.full, room))
        if step.stage in TRACKED:
            waiting.append(found.lose_mlflow(step, options.gone, server))
    steps = {each.stage: each for each in found.steps if each.experiment == options.experiments[0]}
    if "train_baselines" in steps and (not options.stages or "two" in options.stages):
        for wait in ((), ("--wait-for-lock",)):
            waiting.append(found.pair(steps["train_ensemble"], steps["train_ensemble"], options.pairs, wait))
            waiting.append(found.pair(steps["train_addressing"], steps["train_baselines"], options.pairs, wait))
    end = time.monotonic() + 60 * options.minutes
    while waiting:
        found.draw.shuffle(waiting)  # so that in a short time a little of everything is done
        for rounds in [*waiting]:
            if time.monotonic() > end:
                return
            if next(rounds, True):
                waiting = [each for each in waiting if each is not rounds]
            (found.folder / "found.json").write_text(json.dumps(rows(found), indent=1), encoding="utf-8")


def rows(found: Soak) -> list[dict[str, Any]]:
    """Return what came of everything, a row for each stage and kind of disturbance."""
    return [
        {
            "stage": name, "kind": kind, "disturbed": tally.disturbed, "looked": tally.looked, "ended": tally.ended,
            "faults": len(tally.faults), "left": dict(tally.left), "dvc": dict(tally.dvc), "said": dict(tally.said),
        }
        for (name, kind), tally in found.tallies.items()
        if tally.disturbed or tally.faults
    ]  # fmt: skip


def added(kept: Mapping[str, Any], table: Sequence[Mapping[str, Any]], seed: int) -> dict[str, Any]:
    """Return what docs/figures keeps, with what a soak found added: all counts, and what was said most often."""
    stages = {name: dict(kinds) for name, kinds in kept.get("stages", {}).items()}
    said = {kind: Counter(lines) for kind, lines in kept.get("said", {}).items()}
    dvc, left = Counter(kept.get("dvc", {})), Counter(kept.get("left", {}))
    for row in table:
        counts = Counter({key: row[key] for key in COUNTS})
        kinds = stages.setdefault(row["stage"], {})
        kinds[row["kind"]] = {key: (counts + Counter(kinds.get(row["kind"], {})))[key] for key in COUNTS}
        new = {line: number for line, number in row["said"].items() if not line.startswith(NOT_KEPT)}
        said.setdefault(row["kind"], Counter()).update(new)
        dvc, left = dvc + Counter(row["dvc"]), left + Counter(row["left"])
    return {
        "seeds": [*kept.get("seeds", []), seed],
        "stages": stages,
        "dvc": dict(dvc),
        "left": dict(left),
        "said": {kind: dict(lines.most_common(MOST_LINES)) for kind, lines in said.items()},
    }


def keep(path: Path, table: Sequence[Mapping[str, Any]], seed: int) -> None:
    """Add what was found to a file of figures; 'python -m publishing' says in it when that was measured."""
    with FileLock(f"{path}.lock"):
        kept = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}
        path.write_text(json.dumps(added(kept, table, seed), indent=1), encoding="utf-8")


def main() -> None:
    """Soak, print and keep what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a new folder for all that is written, or that of an earlier soak")
    parser.add_argument("--experiments", nargs="+", choices=RAW, default=list(RAW))
    parser.add_argument("--stages", nargs="+", help="only these: record, convert, …, or two for two at once")
    parser.add_argument("--kills", type=int, default=100, help="of each stage, with DVC and its workers")
    parser.add_argument(
        "--looks", type=int, default=20, help="before each kill, at what lies there while all is held still"
    )
    parser.add_argument(
        "--alone", type=int, default=10, help="of a worker alone, of its server, of the resource tracker"
    )
    parser.add_argument("--orphans", type=int, default=10, help="of DVC alone, while the stage goes on")
    parser.add_argument("--full", type=int, default=20, help="times that the disk of each stage is full")
    parser.add_argument("--gone", type=int, default=20, help="times that each stage loses MLflow")
    parser.add_argument("--pairs", type=int, default=10, help="of two 'dvc repro' of each sort")
    parser.add_argument("--minutes", type=float, default=math.inf, help="after which no round begins")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--cold", action="store_true", help="interpreters that import all anew, as a user's do")
    parser.add_argument("--figures", type=Path, help="a JSON file, to which what was found is added")
    options = parser.parse_args()
    if options.folder.exists() and any(options.folder.iterdir()) and not (options.folder / "states").exists():
        parser.error(f"{options.folder}: expected a new folder, or that of an earlier soak")
    small = options.folder / "small"
    if not may_mount(small):
        print("no file system can be mounted here, so no disk is filled", file=sys.stderr)
        options.full = 0
    print(f"seed {options.seed}", flush=True)
    steps = steps_of(options.experiments)
    found = Soak(options.folder, options.seed, steps, warm=not options.cold, looks=options.looks)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("terminated"))
    with ExitStack() as stack:
        stack.callback(kill_all, found.folder)
        server = stack.enter_context(closing(Server(options.folder / "server")))
        room = stack.enter_context(small_file_system(small, found.clone)) if options.full else None
        soak(found, options, room, server)
    table = rows(found)
    print_table(
        ["stage", "kind", *COUNTS],
        [[each["stage"], each["kind"], *(str(each[key]) for key in COUNTS)] for each in table],
    )
    if options.figures:
        keep(options.figures, table, options.seed)
    if any(each["faults"] for each in table):
        sys.exit(f"there are faults; {options.folder / 'faults.txt'} says which")


if __name__ == "__main__":
    main()
