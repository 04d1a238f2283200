"""What Ray costs: forty logs converted by its tasks and by local worker processes, in turns; the start of Ray apart.

Both have two cores and write the same bytes. Needs the extra `ray` (make test-cluster installs it); without it this
says so and measures nothing.
"""

import argparse
import importlib.util
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from measuring import print_table

from addressed_dynamics.base.cluster import ENGINE
from addressed_dynamics.base.processes import worker_processes
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.logs import RunInfo, write_log
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams

LOGS, EPISODES, STEPS = 40, 40, 500
CAR = SpaceSpec(
    observation=(Dimension("position", "m", -1.2, 0.6), Dimension("velocity", "m/step", -0.07, 0.07)),
    action=DiscreteAction(("left", "none", "right")),
    step_seconds=1 / 30,
)


def made_up(seed: int) -> Transitions:
    """Return episodes of a random walk within the bounds."""
    draw, rows = np.random.default_rng(seed), EPISODES * STEPS
    states = draw.uniform([-1.2, -0.07], [0.6, 0.07], (rows, 2)).astype(np.float32)
    ends = np.arange(rows) % STEPS == STEPS - 1
    after = np.where(ends[:, None], states, np.roll(states, -1, axis=0)).astype(np.float32)
    step = (np.arange(rows) % STEPS).astype(np.int32)
    return Transitions(
        spec=CAR,
        time_ns=np.arange(rows, dtype=np.int64) * 33_333_333,
        episode=np.repeat(np.arange(EPISODES), STEPS),
        step=step,
        observation=states,
        action=draw.integers(0, 3, rows),
        exogenous=np.empty((rows, 0), dtype=np.float32),
        next_observation=after,
        reward=np.full(rows, -1.0, dtype=np.float32),
        terminated=np.zeros(rows, dtype=np.bool_),
        truncated=ends,
    )


def timed(call: Callable[[], object]) -> float:
    """Return how long a call takes, in seconds."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    """Print the median seconds of both and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    if importlib.util.find_spec("ray") is None:
        print("Ray is not installed (pip install 'addressed-dynamics[ray]'): nothing measured")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        raw = folder / "raw"
        raw.mkdir()
        for number in range(LOGS):
            run = RunInfo(environment="Walk", segment="walk", behaviour="random", seed=number)
            write_log(raw / f"log-{number:02d}.mcap", iter([made_up(number)]), run=run, topic="/walk")

        def convert(engine: str, place: str) -> None:
            os.environ[ENGINE] = engine
            convert_recording(raw, folder / place, folder, ConvertParams(), cores=2, progress=lambda _: None)

        def start(engine: str) -> None:
            os.environ[ENGINE] = engine
            with worker_processes(2) as ordered_map:
                list(ordered_map(abs, [1, -1]))

        seconds: dict[str, list[float]] = {name: [] for name in ("local", "ray", "local start", "ray start")}
        for _ in range(rounds):
            for engine in ("local", "ray"):
                seconds[f"{engine} start"].append(timed(partial(start, engine)))
                seconds[engine].append(timed(partial(convert, engine, engine)))
        same = all(
            (folder / "ray" / path.relative_to(folder / "local")).read_bytes() == path.read_bytes()
            for path in (folder / "local").rglob("*.parquet")
        )
    middle = {name: statistics.median(each) for name, each in seconds.items()}
    work = {
        name: statistics.median(np.subtract(seconds[name], seconds[f"{name} start"]).tolist())
        for name in ("local", "ray")
    }
    print(
        f"{LOGS} logs of {EPISODES * STEPS:,} transitions; the same bytes: {'yes' if same else 'NO'}; {rounds} rounds"
    )
    print_table(
        ["", "all, s", "start, s", "work, s"],
        [
            [name, f"{middle[name]:.2f}", f"{middle[f'{name} start']:.2f}", f"{work[name]:.2f}"]
            for name in ("local", "ray")
        ],
    )
    print(f"work, Ray's tasks to worker processes: {work['ray'] / work['local']:.2f} (at most 1.3 asked)")


if __name__ == "__main__":
    main()
