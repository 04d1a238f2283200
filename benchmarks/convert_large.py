"""Conversion of 1, 10 and 100 million transitions of MountainCar: seconds, and the most memory of parent and workers.

The logs are written by `logs.write_log`, half a million transitions each: 200 steps of cars under random pushes. Every
step runs in a process of its own, so that none inherits memory. 100 million (`--millions 100`) need 8 GB of disk in
`--folder` and some minutes; 1 and 10 are the default.
"""

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from measuring import peak_mib, print_table

EXPERIMENT = "mountaincar"
PARAMS_FILE = Path(__file__).parents[1] / "params.yaml"
LOG, EPISODE = 500_000, 200
ROW_BYTES = 8 + 4 + 8 + 2 * 4 + 8 + 4 + 2 * 4 + 1 + 1
"""Bytes of a transition in memory: the columns of `Transitions`."""
MIB = 2**20
MOST_MIB = 1024
"""So much beyond a log, in any process, is the target."""


def record(folder: Path, logs: int) -> None:
    """Write the logs; print their bytes."""
    import numpy as np

    from addressed_dynamics.base.params.recording import EnvironmentParams
    from addressed_dynamics.envs.mountain_car import mountain_car_step
    from addressed_dynamics.episodes.transitions import Transitions
    from addressed_dynamics.logs import RunInfo, write_log
    from addressed_dynamics.recording.plan import make_environment
    from addressed_dynamics.recording.spaces import space_spec

    spec = space_spec(make_environment(EnvironmentParams(id="MountainCar-v0", kwargs={})))
    generator, cars = np.random.default_rng(0), LOG // EPISODE
    step_ns = round(spec.step_seconds * 1e9)
    states = np.empty((EPISODE + 1, cars, 2))
    for log in range(logs):
        states[0] = generator.uniform((-0.6, 0.0), (-0.4, 0.0), (cars, 2))
        actions = generator.integers(0, 3, (EPISODE, cars))
        for step in range(EPISODE):
            states[step + 1] = mountain_car_step(states[step], actions[step])
        shown = states.astype(np.float32).transpose(1, 0, 2)
        ends = np.zeros((cars, EPISODE), np.bool_)
        ends[:, -1] = True
        transitions = Transitions(
            spec,
            episode=np.repeat(np.arange(log * cars, (log + 1) * cars), EPISODE),
            step=np.tile(np.arange(EPISODE, dtype=np.int32), cars),
            time_ns=np.arange(LOG, dtype=np.int64) * step_ns,
            observation=shown[:, :-1].reshape(-1, 2).copy(),
            action=actions.T.ravel().copy(),
            reward=np.full(LOG, -1.0, np.float32),
            next_observation=shown[:, 1:].reshape(-1, 2).copy(),
            terminated=np.zeros(LOG, np.bool_),
            truncated=ends.ravel(),
        )
        run = RunInfo(environment="MountainCar-v0", segment="random", behaviour="random")
        write_log(folder / f"random-env00-{log:05d}.mcap", transitions, run=run)
    print(sum(path.stat().st_size for path in folder.iterdir()))


def convert(raw: Path, folder: Path, cores: int) -> None:
    """Convert the logs; print seconds, memory before, the peaks of this process and of its workers, and bytes."""
    from addressed_dynamics.base.params.experiments import load_experiment
    from addressed_dynamics.sources.transitions.conversion import convert_recording

    params = load_experiment(PARAMS_FILE, EXPERIMENT, "transitions").convert
    before, start = peak_mib(), time.perf_counter()
    convert_recording(raw, folder / "tables", folder, params, cores=cores, progress=lambda _: None)
    seconds = time.perf_counter() - start
    written = sum(path.stat().st_size for path in (folder / "tables").rglob("*.parquet"))
    print(seconds, before, peak_mib(), peak_mib(resource.RUSAGE_CHILDREN), written)


def step(*arguments: object) -> list[float]:
    """Run one of the functions above in a process of its own and return what it prints."""
    command = [sys.executable, __file__, *map(str, arguments)]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, [os.environ.get("PYTHONPATH"), str(PARAMS_FILE.parent)]))
    }
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return [float(number) for number in done.stdout.split()]


def main() -> None:
    """Print a row for each size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--millions", type=int, nargs="+", default=[1, 10])
    parser.add_argument("--cores", type=int, default=2)
    parser.add_argument("--folder", type=Path, help="where the logs and tables go meanwhile (default: TMPDIR)")
    options = parser.parse_args()
    rows = []
    for millions in options.millions:
        with tempfile.TemporaryDirectory(dir=options.folder) as name:
            raw, out = Path(name) / "raw", Path(name) / "out"
            raw.mkdir()
            (logs,) = step("record", raw, millions * 1_000_000 // LOG)
            seconds, before, parent, workers, tables = step("convert", raw, out, options.cores)
        rows.append([
            f"{millions}M", f"{seconds:.1f} s", f"{millions / seconds:.2f}", f"{before:.0f}", f"{parent:.0f}",
            f"{workers:.0f}", f"{max(parent, workers) - LOG * ROW_BYTES / MIB:.0f}",
            f"{logs / 1e6:,.0f} MB", f"{tables / 1e6:,.0f} MB",
        ])  # fmt: skip
        print_table(
            ["transitions", "time", "M/s", "MiB before", "parent", "worker", "beyond a log", "logs", "tables"], rows
        )
    print(f"\na log has {LOG * ROW_BYTES / MIB:.0f} MiB in memory; at most {MOST_MIB} MiB beyond one asked")


if __name__ == "__main__":
    match sys.argv[1:]:
        case ["record", raw, logs]:
            record(Path(raw), int(logs))
        case ["convert", raw, folder, cores]:
            convert(Path(raw), Path(folder), int(cores))
        case _:
            main()
