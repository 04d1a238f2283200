"""Training, Algorithm 1 and evaluation on data that are larger than memory: time and memory from 1 to 100 million.

`make bench` leaves it out: `python benchmarks/larger_than_memory.py` takes an hour alone, and 10 GB of disk. Every
step runs in a process of its own, which inherits no memory; the million in memory is trained anew between the larger
ones, so that ratios are of the same hour. `--only evaluation` measures this alone and leaves the other figures.
"""

import argparse
import hashlib
import json
import os
import shutil
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from itertools import islice, pairwise
from pathlib import Path
from typing import Any

from measuring import print_table

ROOT = Path(__file__).parents[1]
PARAMS_FILE = ROOT / "params.yaml"
MILLION = 1_000_000
SHARD, EPISODE, VALIDATION = MILLION, 250, 100_000
ROW_GROUP = 131_072
MIB = 2**20
EVERYTHING, NOTHING = 2**62, 0
"""Bytes of samples that memory is said to hold."""
WIDE = 6
"""Dimensions of a state, with three actions: 54 inputs of six frames."""
STAGED = 10 * MILLION
"""So many are also trained as if the system's cache did not hold them."""
MOST_TRAINED = 10 * MILLION
"""Samples that are trained on at most, of all at random: an epoch that is cut short."""
PROJECT = Path("project") / "data"
TRAIN_STAGES = ("train_ensemble", "train_addressing", "train_baselines")
GOAL = 0.5
"""Position of a car at which an episode of the judged splits ends inside the task, if it ends there."""


class Peaks:
    """The most resident memory of this process so far: all of it, and what is no page of a file."""

    def __init__(self) -> None:
        self.most = {"VmRSS": 0.0, "RssAnon": 0.0, "RssFile": 0.0}
        self.disk = 0.0
        """The most that files without a name had, which this process alone sees."""

    def look(self) -> None:
        """Read what the system says now."""
        lines = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text("ascii").splitlines())
        for name, most in self.most.items():
            self.most[name] = max(most, int(lines[name].split()[0]) / 1024)
        maps = [line.split() for line in Path("/proc/self/maps").read_text("utf-8").splitlines()]
        bounds = [line[0].split("-") for line in maps if line[-1] == "(deleted)"]
        self.disk = max(self.disk, sum(int(end, 16) - int(begin, 16) for begin, end in bounds) / MIB)


@contextmanager
def watched() -> Iterator[Peaks]:
    """Yield the peaks, which a thread looks after ten times a second."""
    peaks, done = Peaks(), threading.Event()

    def watch() -> None:
        while not done.wait(0.1):
            peaks.look()

    thread = threading.Thread(target=watch, daemon=True)
    thread.start()
    try:
        yield peaks
    finally:
        done.set()
        thread.join()
        peaks.look()


def make_tables(folder: Path, rows: int, width: int, validation: int = VALIDATION, test: int = 0) -> None:
    """Write so many transitions under random pushes: of cars, or of random walks of so many dimensions."""
    import numpy as np

    from addressed_dynamics.base.params.recording import EnvironmentParams
    from addressed_dynamics.envs.mountain_car import mountain_car_step
    from addressed_dynamics.episodes.index import Episode, write_episodes
    from addressed_dynamics.episodes.parquet import FOLDER, TransitionTable, table_writer
    from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
    from addressed_dynamics.recording.plan import make_environment
    from addressed_dynamics.recording.spaces import space_spec

    if width == 2:
        spec = space_spec(make_environment(EnvironmentParams(id="MountainCar-v0", kwargs={})))
    else:
        names = tuple(Dimension(f"x{each}", "", -np.inf, np.inf) for each in range(width))
        spec = SpaceSpec(names, DiscreteAction(("left", "none", "right")), 1.0)
    generator, episode = np.random.default_rng(0), 0
    cars = SHARD // EPISODE
    lowest, highest = ((-1.2, -0.07), (0.6, 0.07)) if width == 2 else (-1.0, 1.0)
    walks = np.empty((EPISODE + 1, cars, width))
    walks[0] = generator.uniform(lowest, highest, (cars, width))
    pushes = generator.integers(0, 3, (EPISODE, cars))
    for step in range(EPISODE):
        if width == 2:
            walks[step + 1] = mountain_car_step(walks[step], pushes[step])
        else:
            walks[step + 1] = 0.9 * walks[step] + 0.1 * (pushes[step] - 1)[:, None] * np.arange(1, width + 1)
    index: list[Episode] = []
    for code, (split, wanted) in enumerate({"train": rows, "validation": validation, "test": test}.items()):
        for shard in range(-(-wanted // SHARD)):
            count = min(SHARD, wanted - shard * SHARD) // EPISODE
            actions = pushes[:, :count]
            # The same walks again and again, each time under other noise.
            states = walks[:, :count] + 1e-3 * generator.standard_normal((EPISODE + 1, count, width), dtype=np.float32)
            shown = states.astype(np.float32)
            last = np.tile(np.arange(EPISODE) == EPISODE - 1, count)
            ended = last & (shown[1:, :, 0].T.reshape(-1) >= GOAL)
            transitions = Transitions(
                spec=spec,
                episode=np.repeat(np.arange(episode, episode + count), EPISODE),
                step=np.tile(np.arange(EPISODE, dtype=np.int32), count),
                time_ns=np.tile(np.arange(EPISODE), count) * 10**9,
                observation=shown[:-1].swapaxes(0, 1).reshape(-1, width),
                action=actions.T.reshape(-1),
                reward=shown[1:, :, 0].T.reshape(-1).copy(),
                next_observation=shown[1:].swapaxes(0, 1).reshape(-1, width),
                terminated=ended,
                truncated=last & ~ended,
            )
            index += [
                Episode(each, f"made#{each}", "made", split, 0, EPISODE, 0.0, "truncated", 0)
                for each in range(episode, episode + count)
            ]
            episode += count
            table = TransitionTable(transitions, np.full(len(transitions), code, np.int8), "made")
            with table_writer(
                folder / FOLDER / split / f"made-{shard:03d}.parquet", spec, row_group_rows=ROW_GROUP
            ) as write:
                write(table)
    write_episodes(folder / "episodes.parquet", index)


def train_models(folder: Path) -> dict[str, Any]:
    """Train what MountainCar's evaluation judges on the tables in a project's folder, for one epoch each."""
    changes = {"ensemble": {"epochs": 1, "cluster_epochs": 1}, "addressing": {"epochs": 1}}
    changes["baselines"] = {"addressing": {"epochs": 1}}
    params = {"extends": str(PARAMS_FILE), "mountaincar": changes}
    (folder / "params.yaml").write_text(json.dumps(params), encoding="utf-8")
    begin = time.perf_counter()
    for stage in TRAIN_STAGES:
        command = [sys.executable, "-m", f"pipeline.{stage}", "mountaincar", "--params", "params.yaml"]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(ROOT / "src"), str(ROOT)])}
        subprocess.run(command, env=environment, cwd=folder, check=True)
    return {"wall": time.perf_counter() - begin}


def evaluate(tables: Path, memory: int) -> dict[str, Any]:
    """Evaluate what `train_models` trained on the judged splits in a folder of tables; say what it took."""
    from addressed_dynamics.base.params.experiments import load_experiment
    from addressed_dynamics.base.torch_runtime import prepare_torch
    from addressed_dynamics.evaluation.common.evaluated import write_evaluated
    from addressed_dynamics.evaluation.transitions.kind import evaluate as evaluate_transitions
    from addressed_dynamics.features.common.spool import Spool

    prepare_torch(threads=1)
    params, out = load_experiment(PARAMS_FILE, "mountaincar", "transitions").evaluation, tables / "evaluation"
    with watched() as peaks:
        peaks.look()
        before, wall, cpu = peaks.most["VmRSS"], time.perf_counter(), time.process_time()
        spool = Spool(tables / "scratch", memory)
        models = tables.parent / PROJECT / "models" / "mountaincar"
        found = evaluate_transitions(tables, models, params, cores=1, spool=spool)
        seconds = {"wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu}
        shutil.rmtree(out, ignore_errors=True)
        write_evaluated(found, out)
        seconds |= {"with_writing": time.process_time() - cpu}
    digest = hashlib.blake2b(digest_size=8)
    for path in sorted(out.iterdir()):
        digest.update(path.read_bytes())
    test = found.report["test"]["transitions"]
    return {"test": test, **seconds, "before": before, "digest": digest.hexdigest(), "disk": peaks.disk, **peaks.most}


def train(
    tables: Path, memory: int, history: int, most: int, addressed: bool, *, staged: bool = False
) -> dict[str, Any]:
    """Train an ensemble of MountainCar's params, for an epoch of so many samples at most; say what it took.

    If it is `staged`, samples are laid out in the order of the epoch, as if no cache held them.
    """
    from addressed_dynamics.base.params.experiments import load_experiment
    from addressed_dynamics.base.torch_runtime import prepare_torch
    from addressed_dynamics.features.common.spool import Spool, beside
    from addressed_dynamics.features.transitions.kind import load_training_data
    from addressed_dynamics.training import staging
    from addressed_dynamics.training.addressing import train_addressing
    from addressed_dynamics.training.ensemble import evaluate_profiles, train_ensemble
    from addressed_dynamics.training.losses import reported_loss

    prepare_torch(threads=1)
    if staged:
        staging.free_memory = lambda: 0
    sections = load_experiment(PARAMS_FILE, "mountaincar", "transitions")
    params = sections.ensemble.model_copy(update={"epochs": 1, "cluster_epochs": 1})
    with watched() as peaks:
        peaks.look()
        before, begin = peaks.most["VmRSS"], time.perf_counter()
        features = sections.features.model_copy(update={"history": history})
        data = load_training_data(tables, sections, features, spool=Spool(tables / "spools", memory))
        clocks = [(time.perf_counter(), time.process_time())]
        loaded = clocks[0][0]

        def note(x: Any, y: Any, _: Any) -> tuple[Any, Any]:
            if len(clocks) == 1:
                clocks.append((time.perf_counter(), time.process_time()))
            return x, y

        updates = min(most, len(data.train)) // (params.members * params.batch_size)
        *_, last = train_ensemble(
            data.train, data.validation, params, seed=0, loss_unit=1.0, augment=note, updates=updates
        )
        clocks.append((time.perf_counter(), time.process_time()))
        (binning, binning_cpu), (wall, cpu) = (
            (later[0] - earlier[0], later[1] - earlier[1]) for earlier, later in pairwise(clocks)
        )
        digest = hashlib.blake2b(digest_size=8)
        for parameter in last.network.parameters():
            digest.update(parameter.detach().numpy().tobytes())
        found: dict[str, Any] = {"load": loaded - begin, "binning": binning, "binning_cpu": binning_cpu}
        found |= {"wall": wall, "cpu": cpu, "samples": last.samples, "transitions": len(data.train)}
        if addressed:
            loss = reported_loss(params.loss)
            profiles = [
                evaluate_profiles(last.network, part, loss, make=beside(part, "profiles"))
                for part in (data.train, data.validation)
            ]
            settings = sections.addressing.model_copy(update={"epochs": 1})
            wall, cpu = time.perf_counter(), time.process_time()
            *_, end = train_addressing(
                data.train, profiles[0], data.validation, profiles[1], settings, seed=0, variant="cost_sensitive"
            )
            found |= {"addressing_wall": time.perf_counter() - wall, "addressing_cpu": time.process_time() - cpu}
            found["addressing_samples"] = end.samples
            for parameter in end.network.parameters():
                digest.update(parameter.detach().numpy().tobytes())
    if memory == NOTHING and len(data.train) > MILLION:
        found |= side_by_side(data.train)
    data.discard()
    return found | {"before": before, "digest": digest.hexdigest(), **peaks.most}


def side_by_side(samples: Any, rounds: int = 5) -> dict[str, float]:
    """Return how fast samples in files are beside their first million in memory, in profiles and in updates.

    Both take turns within seconds, so that what else the machine does hits them alike: of each round the ratio of
    samples in a second of a processor, and of all rounds the median.
    """
    import torch

    from addressed_dynamics.base.params.experiments import load_experiment
    from addressed_dynamics.features.common.samples import Samples, Windows
    from addressed_dynamics.training.ensemble import evaluate_profiles, untrained_ensemble
    from addressed_dynamics.training.epochs import draw_order
    from addressed_dynamics.training.losses import REGRESSION_LOSSES
    from addressed_dynamics.training.update import StackTrainer

    params, x = load_experiment(PARAMS_FILE, "mountaincar", "transitions").ensemble.with_members(2), samples.x
    generator, zeros = torch.Generator().manual_seed(0), torch.zeros(MILLION, dtype=torch.int64)

    def part(first: int, copied: bool) -> Samples:
        rows = slice(first, first + MILLION)
        y = samples.y[rows]
        if isinstance(x, Windows):
            last = x.last[rows]
            begin = int(last[0]) - len(x.weights) + 1
            frames = x.frames[begin : int(last[-1]) + 1]
            own = Windows(frames.clone() if copied else frames, last - begin, x.weights)
            return Samples(own, y.clone() if copied else y, zeros[: len(y)], zeros[: len(y)])
        return Samples(x[rows].clone() if copied else x[rows], y.clone() if copied else y, zeros, zeros)

    in_memory = part(0, copied=True)
    stack = untrained_ensemble(x.shape[1], samples.y.shape[1], params, seed=0)
    trainer = StackTrainer(stack, REGRESSION_LOSSES[params.loss], params.optimiser, 10**6)

    def update(some: Samples, order: Any) -> None:
        for batch in islice(order, 1400):
            trainer.update(some.x[batch.rows], some.y[batch.rows], batch.weight)

    orders = {
        name: draw_order(torch.arange(len(each), dtype=torch.int32) % 2, 2, generator).batches(params.batch_size)
        for name, each in (("memory", in_memory), ("files", samples))
    }
    ratios: dict[str, list[float]] = {"profiles": [], "updates": []}
    for number in range(rounds):
        away = part((number + 1) * (len(samples) // (rounds + 1) // MILLION) * MILLION, copied=False)
        seconds = {}
        for name, work in {
            "profiles/memory": lambda: evaluate_profiles(stack, in_memory, "mae"),
            "profiles/files": lambda away=away: evaluate_profiles(stack, away, "mae"),
            "updates/memory": lambda: update(in_memory, orders["memory"]),
            "updates/files": lambda: update(samples, orders["files"]),
        }.items():
            begin = time.process_time()
            work()
            seconds[name] = time.process_time() - begin
        for name, found in ratios.items():
            found.append(seconds[f"{name}/memory"] / seconds[f"{name}/files"])
    return {f"{name}_ratio": statistics.median(found) for name, found in ratios.items()} | {
        f"{name}_lowest": min(found) for name, found in ratios.items()
    }


def bin_in_turns(folder: Path, samples: int, members: int, *, mapped: bool) -> dict[str, Any]:
    """Run Algorithm 1 on random profiles, in memory or in a file, beside one sort; say what it took."""
    import torch

    from addressed_dynamics.features.common.spool import _scratch, release
    from addressed_dynamics.training.clustering import small_bins

    torch.set_num_threads(1)
    seconds = dict[str, float]()
    if not mapped:
        numbers = torch.rand(samples, generator=torch.Generator().manual_seed(1))
        begin = time.process_time()
        torch.sort(numbers)
        seconds["sort"] = time.process_time() - begin
        del numbers

    def make(shape: Any, dtype: torch.dtype, **_: Any) -> torch.Tensor:
        return _scratch(folder, None, shape, dtype) if mapped else torch.empty(shape, dtype=dtype)

    losses, generator = make((samples, members), torch.float32), torch.Generator().manual_seed(0)
    for first in range(0, samples, MILLION):
        torch.rand(losses[first : first + MILLION].shape, generator=generator, out=losses[first : first + MILLION])
    release(losses)
    with watched() as peaks:
        begin, wall = time.process_time(), time.perf_counter()
        bins = small_bins(losses, make=make)
        seconds["assign"], seconds["assign_wall"] = time.process_time() - begin, time.perf_counter() - wall
    counts = torch.zeros(members, dtype=torch.int64)
    for part in bins.split(MILLION):
        counts += torch.bincount(part, minlength=members)
    digest = hashlib.blake2b(bins.numpy().data, digest_size=8).hexdigest()
    return {**seconds, "digest": digest, "bins": counts.tolist(), **peaks.most}


def step(folder: Path, name: str, **values: Any) -> dict[str, Any]:
    """Return what one of the functions above found, in a process of its own; it is not run again if that is known."""
    kept = folder / "-".join([name, *(f"{key}{value}" for key, value in values.items())])
    if not kept.exists():
        command = [sys.executable, __file__, "--step", name, "--folder", str(folder), "--values", json.dumps(values)]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
        done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
        kept.write_text(done.stdout.splitlines()[-1], encoding="utf-8")
    found: dict[str, Any] = json.loads(kept.read_text("utf-8"))
    print(name, values, {key: round(v, 2) if isinstance(v, float) else v for key, v in found.items()}, file=sys.stderr)
    return found


def run_step(name: str, folder: Path, values: dict[str, Any]) -> dict[str, Any]:
    """Do what `step` asks for."""
    if name == "make":
        begin = time.perf_counter()
        make_tables(folder, **values)
        return {"wall": time.perf_counter() - begin}
    if name == "models":
        return train_models(folder)
    values.pop("turn", None)
    if name == "train":
        return train(folder, **values)
    if name == "evaluate":
        return evaluate(folder, **values)
    return bin_in_turns(folder, **values)


def trainings(folder: Path, sizes: list[int], *, width: int, history: int) -> dict[str, Any]:
    """Train on a million in memory and in files, and on more in files; return what was found, by size."""
    settings = {"history": history, "most": MOST_TRAINED}
    of_million = settings | {"addressed": history == 1}
    tables = folder / f"tables-{width}-million"
    step(tables, "make", rows=MILLION, width=width)
    in_memory = [step(tables, "train", memory=EVERYTHING, turn=0, **of_million)]
    found = {str(MILLION): step(tables, "train", memory=NOTHING, **of_million)}
    for turn, size in enumerate(sizes, start=1):
        if size > MILLION:
            larger = folder / f"tables-{width}-{size}"
            step(larger, "make", rows=size, width=width)
            found[str(size)] = step(larger, "train", memory=NOTHING, **settings, addressed=False)
            if size == STAGED:
                found["staged"] = step(larger, "train", memory=NOTHING, **settings, addressed=False, staged=True)
            shutil.rmtree(larger / "transitions", ignore_errors=True)
        in_memory.append(step(tables, "train", memory=EVERYTHING, turn=turn, **of_million))
    staged = found.pop("staged", None)
    return {"in_memory": in_memory, "streamed": found, "staged": staged}


def evaluations(folder: Path, sizes: list[int]) -> dict[str, Any]:
    """Evaluate so many test and as many validation transitions; return what was found, by size, in files and not."""
    found = dict[str, Any]()
    step(folder / PROJECT / "tables" / "mountaincar", "make", rows=2 * VALIDATION, width=2)
    step(folder / PROJECT.parent, "models")
    for size in sizes:
        tables = folder / f"judged-{size}"
        step(tables, "make", rows=2 * VALIDATION, width=2, validation=size, test=size)
        for name, memory in {"in_memory": EVERYTHING, "in_files": NOTHING}.items():
            if name == "in_files" or size <= MILLION:
                found.setdefault(name, {})[str(size)] = step(tables, "evaluate", memory=memory)
        shutil.rmtree(tables / "transitions", ignore_errors=True)
    return found


def main() -> None:
    """Print what was found; with `--figures`, write it, too."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--folder", type=Path, help="where 10 GB of files may lie for a while")
    parser.add_argument("--keep", action="store_true", help="keep the folder, and go on in it when it was cut off")
    parser.add_argument("--largest", type=int, default=100 * MILLION, help="transitions")
    parser.add_argument("--wide", type=int, default=20 * MILLION, help="transitions with six frames; 0 for none")
    parser.add_argument("--profiles", type=int, default=100 * MILLION, help="loss profiles for Algorithm 1")
    parser.add_argument("--judged", type=int, default=10 * MILLION, help="test transitions, and as many for validation")
    parser.add_argument("--only", choices=("trainings", "evaluation"), help="measure no more; others stay as they are")
    parser.add_argument("--figures", type=Path, help="file to write")
    parser.add_argument("--chart", type=Path, help="SVG to draw")
    parser.add_argument("--step", help=argparse.SUPPRESS)
    parser.add_argument("--values", default="{}", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.step:
        options.folder.mkdir(parents=True, exist_ok=True)
        print(json.dumps(run_step(options.step, options.folder, json.loads(options.values))))
        return
    with nullcontext(options.folder) if options.keep else tempfile.TemporaryDirectory(dir=options.folder) as place:
        folder = Path(place)
        known = options.figures is not None and options.only and options.figures.exists()
        found: dict[str, Any] = json.loads(options.figures.read_text("utf-8")) if known else {}
        if options.only != "evaluation":
            found["bins"] = {
                name: step(folder, "bins", samples=options.profiles, members=4, mapped=name == "in_a_file")
                for name in ("in_memory", "in_a_file")
            }
            found["trainings"] = trainings(folder, _up_to(options.largest), width=2, history=1)
            if options.wide:
                found["six_frames"] = trainings(folder, [options.wide], width=WIDE, history=6)
        if options.only != "trainings":
            found["evaluation"] = evaluations(folder, _up_to(options.judged))
    report(found)
    if options.figures:
        options.figures.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8")
    if options.chart:
        draw(found, options.chart)


def draw(found: dict[str, Any], path: Path) -> None:
    """Draw how time and memory grow with the number of transitions."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams |= {"svg.fonttype": "none", "svg.hashsalt": "larger-than-memory", "font.family": "sans-serif"}
    from matplotlib import pyplot

    sizes = {int(size): each for size, each in found["trainings"]["streamed"].items()}
    figure, (time_axis, memory_axis) = pyplot.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    seconds = {
        "an epoch with Algorithm 1": [per_sample(each, "cpu") * size for size, each in sizes.items()],
        "of which profiles and bins": [each["binning_cpu"] for each in sizes.values()],
    }
    memory = {
        "resident": [each["VmRSS"] / 1024 for each in sizes.values()],
        "no page of a file": [each["RssAnon"] / 1024 for each in sizes.values()],
    }
    for axis, lines, label in ((time_axis, seconds, "seconds of a processor"), (memory_axis, memory, "GiB")):
        for (name, values), colour in zip(lines.items(), ("#0b5c8a", "#c2571a"), strict=True):
            axis.plot([*sizes], values, marker="o", color=colour, label=name)
        axis.set(xscale="log", xlabel="transitions", ylabel=label)
        axis.grid(visible=True, color="#dddddd")
        axis.spines[["top", "right"]].set_visible(False)
    time_axis.set_yscale("log")
    memory_axis.axhline(4, color="#777777", linestyle="--", label="4 GiB")
    memory_axis.set_ylim(bottom=0)
    for axis in (time_axis, memory_axis):
        axis.legend(frameon=False)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, metadata={"Date": None})


def _up_to(largest: int) -> list[int]:
    return [size for size in (MILLION, 10 * MILLION, 100 * MILLION) if size < largest] + [largest]


def per_sample(found: dict[str, Any], clock: str) -> float:
    """Return the seconds of an epoch with Algorithm 1 that a sample takes."""
    binning = found["binning" if clock == "wall" else "binning_cpu"]
    return float(binning / found["transitions"] + found[clock] / found["samples"])


def report(found: dict[str, Any]) -> None:
    """Print the ratios."""
    for name in ("trainings", "six_frames"):
        if name not in found:
            continue
        in_memory, rows = found[name]["in_memory"], []
        for number, (size, each) in enumerate(found[name]["streamed"].items()):
            beside = in_memory[min(number, len(in_memory) - 2) :][:2]
            ratios = [
                sum(per_sample(one, clock) for one in beside) / len(beside) / per_sample(each, clock)
                for clock in ("wall", "cpu")
            ]
            seconds = [f"{each[part]:.0f} s" for part in ("load", "binning", "wall")]
            memory = [f"{each[part]:,.0f}" for part in ("VmRSS", "RssAnon", "RssFile")]
            rows.append([f"{int(size):,}", *seconds, *(f"{ratio:.2f}" for ratio in ratios), *memory])
        headings = [
            "reading",
            "binning",
            "training",
            "of the million's samples/s",
            "by CPU",
            "MiB",
            "anonymous",
            "files",
        ]
        print_table([name, *headings], rows)
        for size, each in found[name]["streamed"].items():
            if "updates_ratio" in each:
                lowest = f"lowest {each['updates_lowest']:.2f} and {each['profiles_lowest']:.2f}"
                ratios = f"{each['updates_ratio']:.2f} in updates, {each['profiles_ratio']:.2f} in profiles ({lowest})"
                print(f"{int(size):,} in turns with their first million in memory, samples/s by CPU: {ratios}")
        if staged := found[name]["staged"]:
            ratio = per_sample(found[name]["streamed"][str(STAGED)], "cpu") / per_sample(staged, "cpu")
            print(f"{STAGED:,} laid out in the order of the epoch: {ratio:.2f} of the samples/s (by CPU)")
        same = in_memory[0]["digest"] == found[name]["streamed"][str(MILLION)]["digest"]
        print(f"the same million in memory and streamed: {'the same bytes' if same else 'OTHER BYTES'}")
    if "evaluation" in found:
        report_evaluation(found["evaluation"])
    if bins := found.get("bins"):
        sort = bins["in_memory"]["sort"]
        for name, each in bins.items():
            print(f"Algorithm 1 {name}: {each['assign'] / sort:.2f} of one sort, {each['VmRSS']:,.0f} MiB")
        print(f"the same bins: {bins['in_memory']['digest'] == bins['in_a_file']['digest']}")


def report_evaluation(found: dict[str, Any]) -> None:
    """Print what evaluations took."""
    rows = [
        [f"{int(size):,}", where.replace("_", " "), f"{each['wall']:.0f} s", f"{each['cpu']:.0f} s"]
        + [f"{each[part]:,.0f}" for part in ("VmRSS", "RssAnon", "RssFile", "disk")]
        for where, sizes in found.items()
        for size, each in sizes.items()
    ]
    print_table(["evaluation", "", "wall", "CPU", "MiB", "anonymous", "files", "MiB on the disk"], rows)
    for size, each in found["in_memory"].items():
        same = each["digest"] == found["in_files"][size]["digest"]
        print(f"{int(size):,} judged in memory and in files: {'the same bytes' if same else 'OTHER BYTES'}")


if __name__ == "__main__":
    main()
