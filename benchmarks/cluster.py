"""What Ray costs: forty logs converted by its tasks and by local worker processes, in turns; the start of Ray apart.

Both have two cores and write the same bytes. Beside them Ray's own reader of MCAP logs, on the same logs and cores: its
rows as they come, a message in each, and decoded to columns in Parquet, as one would do it with protobuf. Needs the
extra `ray` (make test-cluster installs it); without it this says so and measures nothing.
"""

import argparse
import importlib.util
import logging
import os
import statistics
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from google.protobuf import descriptor_pb2, message_factory
from measuring import median_ratio, print_table

from addressed_dynamics.base.cluster import ENGINE, Ray, cluster_map
from addressed_dynamics.base.processes import worker_processes
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.logs import RunInfo, write_log
from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams

LOGS, STEPS = 40, 500
CAR = SpaceSpec(
    observation=(Dimension("position", "m", -1.2, 0.6), Dimension("velocity", "m/step", -0.07, 0.07)),
    action=DiscreteAction(("left", "none", "right")),
    step_seconds=1 / 30,
)


def made_up(seed: int, episodes: int) -> Transitions:
    """Return so many episodes of a random walk within the bounds."""
    draw, rows = np.random.default_rng(seed), episodes * STEPS
    states = draw.uniform([-1.2, -0.07], [0.6, 0.07], (rows, 2)).astype(np.float32)
    ends = np.arange(rows) % STEPS == STEPS - 1
    after = np.where(ends[:, None], states, np.roll(states, -1, axis=0)).astype(np.float32)
    step = (np.arange(rows) % STEPS).astype(np.int32)
    return Transitions(
        spec=CAR,
        time_ns=np.arange(rows, dtype=np.int64) * 33_333_333,
        episode=np.repeat(np.arange(episodes), STEPS),
        step=step,
        observation=states,
        action=draw.integers(0, 3, rows),
        exogenous=np.empty((rows, 0), dtype=np.float32),
        next_observation=after,
        reward=np.full(rows, -1.0, dtype=np.float32),
        terminated=np.zeros(rows, dtype=np.bool_),
        truncated=ends,
    )


def decoded(batch: dict[str, Any]) -> dict[str, Any]:
    """Return the columns of the transitions among some messages."""
    rows = np.flatnonzero(batch["schema_name"] == "addressed_dynamics.Transition").tolist()
    if not rows:
        return {}
    files = descriptor_pb2.FileDescriptorSet.FromString(batch["schema_data"][rows[0]]).file
    parse = message_factory.GetMessages(list(files))["addressed_dynamics.Transition"].FromString
    columns: dict[str, list[Any]] = {"log_time": batch["log_time"][rows].tolist()}
    for row in rows:
        message = parse(batch["data"][row])
        for field in message.DESCRIPTOR.fields:
            value = getattr(message, field.name)
            if field.message_type is None:
                columns.setdefault(field.name, []).append(value)
            else:
                for inner in field.message_type.fields:
                    columns.setdefault(f"{field.name}.{inner.name}", []).append(getattr(value, inner.name))
    return {name: np.array(column) for name, column in columns.items()}


def read_by_ray(raw: Path, folder: Path) -> tuple[float, float]:
    """Return the seconds in which Ray's own reader gives all messages, and writes columns of them as Parquet."""
    with cluster_map(Ray(None)):
        import ray

        context = ray.data.DataContext.get_current()
        context.enable_progress_bars = False
        logging.getLogger("ray.data").setLevel(logging.ERROR)
        files = sorted(str(path) for path in raw.glob("*.mcap"))
        ray.data.read_mcap(files[:1]).materialize()  # the workers have begun
        messages = timed(lambda: ray.data.read_mcap(files).materialize())
        columns = timed(
            lambda: ray.data.read_mcap(files).map_batches(decoded, batch_format="numpy").write_parquet(str(folder))
        )
        return messages, columns


def timed(call: Callable[[], object]) -> float:
    """Return how long a call takes, in seconds."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def main() -> None:
    """Print the median seconds of both and their ratio."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=40, help=f"in a log, of {STEPS} transitions")
    parser.add_argument("--alone", action="store_true", help="without Ray's own reader beside it")
    options = parser.parse_args()
    rounds, episodes = options.rounds, options.episodes
    if importlib.util.find_spec("ray") is None:
        print("Ray is not installed (pip install 'addressed-dynamics[ray]'): nothing measured")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        raw = folder / "raw"
        raw.mkdir()
        for number in range(LOGS):
            run = RunInfo(environment="Walk", segment="walk", behaviour="random", seed=number)
            write_log(raw / f"log-{number:02d}.mcap", iter([made_up(number, episodes)]), run=run, topic="/walk")

        def convert(engine: str, place: str) -> None:
            os.environ[ENGINE] = engine
            convert_recording(raw, folder / place, folder, ConvertParams(), cores=2, progress=lambda _: None)

        def start(engine: str) -> None:
            os.environ[ENGINE] = engine
            with worker_processes(2) as ordered_map:
                list(ordered_map(abs, [1, -1]))

        names = ("local", "ray", "local start", "ray start", "messages", "columns")
        seconds: dict[str, list[float]] = {name: [] for name in names}
        for round_ in range(rounds):
            if not options.alone:
                found = read_by_ray(raw, folder / f"read-{round_}")
                for name, each in zip(("messages", "columns"), found, strict=True):
                    seconds[name].append(each)
            for engine in ("local", "ray"):
                seconds[f"{engine} start"].append(timed(partial(start, engine)))
                seconds[engine].append(timed(partial(convert, engine, engine)))
        same = all(
            (folder / "ray" / path.relative_to(folder / "local")).read_bytes() == path.read_bytes()
            for path in (folder / "local").rglob("*.parquet")
        )
    middle = {name: statistics.median(each) for name, each in seconds.items() if each}
    work = {
        name: statistics.median(np.subtract(seconds[name], seconds[f"{name} start"]).tolist())
        for name in ("local", "ray")
    }
    print(
        f"{LOGS} logs of {episodes * STEPS:,} transitions; the same bytes: {'yes' if same else 'NO'}; {rounds} rounds"
    )
    print_table(
        ["", "all, s", "start, s", "work, s"],
        [
            [name, f"{middle[name]:.2f}", f"{middle[f'{name} start']:.2f}", f"{work[name]:.2f}"]
            for name in ("local", "ray")
        ],
    )
    print(f"work, Ray's tasks to worker processes: {work['ray'] / work['local']:.2f} (at most 1.3 asked)")
    if options.alone:
        return
    ours = np.subtract(seconds["ray"], seconds["ray start"]).tolist()
    rows = LOGS * episodes * STEPS
    print_table(
        ["Ray's own reader, its start apart", "rows/s", "ours is faster by"],
        [
            [label, f"{rows / statistics.median(found):,.0f}", f"{median_ratio(found, ours):.1f} x"]
            for label, found in (
                ("read_mcap: a message a row, undecoded", seconds["messages"]),
                ("read_mcap, protobuf, write_parquet", seconds["columns"]),
                ("convert: columns, splits, statistics, account", ours),
            )
        ],
    )


if __name__ == "__main__":
    main()
