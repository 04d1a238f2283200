"""The most memory that converting and training take on a million transitions, each step in a process of its own."""

import os
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from measuring import peak_mib, print_table

if TYPE_CHECKING:
    from addressed_dynamics.episodes.transitions import Transitions

EXPERIMENT = "mountaincar"
PARAMS_FILE = Path(__file__).parents[1] / "params.yaml"
SHARD = 50_000
EPISODE = 250
TRAINING_EPOCHS = 2
MIB = 2**20


def record(shards: int) -> None:
    """Write logs of a car under random pushes; print the size of a shard in memory."""
    import numpy as np

    from addressed_dynamics.base.params.recording import EnvironmentParams
    from addressed_dynamics.envs.mountain_car import mountain_car_step
    from addressed_dynamics.logs import RunInfo, TransitionLogWriter
    from addressed_dynamics.recording.plan import make_environment
    from addressed_dynamics.recording.spaces import space_spec

    spec = space_spec(make_environment(EnvironmentParams(id="MountainCar-v0", kwargs={})))
    info = RunInfo(environment="MountainCar-v0")
    generator = np.random.default_rng(0)
    folder = Path("data") / "raw" / EXPERIMENT
    folder.mkdir(parents=True)
    cars = SHARD // EPISODE
    for shard in range(shards):
        states = np.empty((EPISODE + 1, cars, 2))
        states[0] = generator.uniform((-1.2, -0.07), (0.6, 0.07), (cars, 2))
        actions = generator.integers(0, 3, (EPISODE, cars))
        for step in range(EPISODE):
            states[step + 1] = mountain_car_step(states[step], actions[step])
        shown = states.astype(np.float32)
        with TransitionLogWriter(folder / f"synthetic-env00-{shard:03d}.mcap", spec, run=info) as writer:
            for car in range(cars):
                for step in range(EPISODE):
                    writer.append(shard * cars + car, step, shown[step, car], actions[step, car], -1.0,
                                  shown[step + 1, car], False, step == EPISODE - 1)  # fmt: skip
                writer.end_episode(None, cut=False)
    row_bytes = 8 + 4 + 8 + 2 * 4 + 8 + 4 + 2 * 4 + 1 + 1  # the columns of Transitions
    print(SHARD * row_bytes / MIB)


def write_long(millions: int) -> None:
    """Write one log of so many million transitions, in blocks; print the memory before, and the peak."""
    from dataclasses import replace

    import numpy as np
    from logs import RUN, random_walks

    from addressed_dynamics.logs import write_log

    block = random_walks(250_000, 2)
    episodes, nanoseconds = int(block.episode[-1]) + 1, int(block.time_ns[-1] + block.time_ns[1])

    def blocks() -> "Iterator[Transitions]":
        for number in range(4 * millions):
            shift = {"episode": block.episode + number * episodes, "time_ns": block.time_ns + number * nanoseconds}
            yield replace(block, **{name: column.astype(np.int64) for name, column in shift.items()})

    folder = Path("data") / "raw" / EXPERIMENT
    folder.mkdir(parents=True)
    before = peak_mib()
    write_log(folder / "long.mcap", blocks(), run=RUN)
    print(before, peak_mib(), (folder / "long.mcap").stat().st_size / MIB)


def read_long() -> None:
    """Read that log chunk by chunk; print the memory before, and the peak."""
    from addressed_dynamics.logs import read_blocks

    before = peak_mib()
    count = sum(len(block.transitions) for block in read_blocks(Path("data") / "raw" / EXPERIMENT / "long.mcap"))
    print(before, peak_mib(), count)


def convert() -> None:
    """Convert the logs; print the memory before, and the peak of this process and of its workers."""
    from addressed_dynamics.base.params.experiments import load_experiment
    from addressed_dynamics.sources.transitions.conversion import convert_recording

    params = load_experiment(PARAMS_FILE, EXPERIMENT, "transitions").convert
    before = peak_mib()
    folders = [Path("data") / kind / EXPERIMENT for kind in ("raw", "tables", "reports")]
    convert_recording(*folders, params, cores=2, progress=lambda _: None)
    print(before, max(peak_mib(), peak_mib(resource.RUSAGE_CHILDREN)))


def train() -> None:
    """Train as the stage does, for a few epochs; print the memory before, the peak and the number of transitions."""
    from addressed_dynamics.base.params.experiments import load_experiment
    from addressed_dynamics.base.torch_runtime import prepare_torch
    from addressed_dynamics.features.transitions.kind import load_training_data
    from addressed_dynamics.training.ensemble import train_ensemble

    prepare_torch(threads=1)
    before = peak_mib()
    sections = load_experiment(PARAMS_FILE, EXPERIMENT, "transitions")
    params = sections.ensemble.model_copy(update={"epochs": TRAINING_EPOCHS, "cluster_epochs": TRAINING_EPOCHS})
    data = load_training_data(Path("data/tables") / EXPERIMENT, sections, sections.features)
    for _ in train_ensemble(data.train, data.validation, params, seed=0, loss_unit=1.0):
        pass
    print(before, peak_mib(), len(data.train) + len(data.validation))


def step(folder: Path, *arguments: str) -> list[float]:
    """Run one of the functions above in a process of its own, which inherits no memory, and return what it prints."""
    command = [sys.executable, __file__, *arguments]
    environment = os.environ | {"PYTHONPATH": str(PARAMS_FILE.parent)}
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return [float(number) for number in done.stdout.split()]


def main() -> None:
    """Print the peaks."""
    rows = []
    for shards in (4, 24):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            (shard_mib,) = step(folder, "record", str(shards))
            before, peak = step(folder, "convert")
            rows.append([
                f"convert {shards} shards of {SHARD:,}, any process", f"{before:.0f} MiB", f"{peak:.0f} MiB",
                f"a shard has {shard_mib:.1f} MiB, all have {shards * shard_mib:.0f} MiB",
            ])  # fmt: skip
            if shards > 4:
                before, peak, count = step(folder, "train")
                rows.append([
                    f"train on {count:,.0f} transitions", f"{before:.0f} MiB", f"{peak:.0f} MiB", "target: < 1,500 MB"
                ])  # fmt: skip
    for millions in (1, 10):
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            before, peak, size = step(folder, "write", str(millions))
            note = f"the log has {size:.0f} MiB"
            rows.append([f"write {millions}M to one log", f"{before:.0f} MiB", f"{peak:.0f} MiB", note])
            before, peak, count = step(folder, "read")
            rows.append([f"read {count:,.0f} in chunks", f"{before:.0f} MiB", f"{peak:.0f} MiB", note])
            before, peak = step(folder, "convert")
            rows.append([f"convert {millions}M from one log", f"{before:.0f} MiB", f"{peak:.0f} MiB", note])
    print_table(["", "before", "peak", ""], rows)


if __name__ == "__main__":
    if len(sys.argv) == 1:
        main()
    else:
        count = int(sys.argv[2]) if len(sys.argv) > 2 else 0
        steps = {"record": lambda: record(count), "write": lambda: write_long(count), "read": read_long}
        (steps | {"convert": convert, "train": train})[sys.argv[1]]()
