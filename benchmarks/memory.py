"""Resident memory at its peak: training on a million transitions, and converting logs of different sizes."""

import multiprocessing
import resource
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from addressed_dynamics.conversion import convert_recording
from addressed_dynamics.logs import RunInfo, TransitionLogWriter
from addressed_dynamics.params import load_params
from addressed_dynamics.recording.spaces import space_spec

PARAMS = load_params(Path(__file__).parents[1] / "params.yaml", "mountaincar")
EPISODE = 200


def peak_megabytes(function: Callable[..., None], *arguments: object) -> float:
    """Return the most resident memory of a fresh process that calls `function`."""
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_measure, args=(sender, function, arguments))
    process.start()
    megabytes = receiver.recv()
    process.join()
    return float(megabytes)


def _measure(sender, function, arguments) -> None:
    function(*arguments)
    sender.send(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def nothing() -> None:
    """Import what training imports."""
    import addressed_dynamics.training.ensemble  # noqa: F401


def train(transitions: int) -> None:
    """Train two epochs of phase 1 on made-up transitions."""
    import torch

    from addressed_dynamics.features.samples import Samples
    from addressed_dynamics.training.ensemble import train_ensemble
    from addressed_dynamics.training.runtime import prepare_torch

    prepare_torch(threads=1)
    generator = torch.Generator().manual_seed(0)

    def samples(count: int) -> Samples:
        rows = torch.arange(count)
        return Samples(
            torch.randn(count, 5, generator=generator), torch.randn(count, 2, generator=generator), rows, rows
        )

    params = PARAMS.ensemble.model_copy(update={"epochs": 2, "cluster_epochs": 2, "batch_size": 4096})
    for _ in train_ensemble(samples(transitions), samples(transitions // 10), params, seed=0, loss_unit=1.0):
        pass


def write_shards(folder: Path, shards: int, transitions: int) -> None:
    """Write logs of made-up MountainCar transitions."""
    import gymnasium

    spec = space_spec(gymnasium.make("MountainCar-v0"))
    run = RunInfo(
        environment="MountainCar-v0", kwargs={}, versions={}, started="", segment="made_up", behaviour="random", seed=0
    )
    generator = np.random.default_rng(0)
    for shard in range(shards):
        with TransitionLogWriter(folder / f"made_up-env{shard:02d}-000.mcap", spec, run=run) as writer:
            for episode in range(transitions // EPISODE):
                states = generator.uniform((-1.2, -0.07), (0.6, 0.07), (EPISODE + 1, 2)).astype(np.float32)
                for step in range(EPISODE):
                    number = shard * 1_000_000 + episode
                    writer.append(number, step, states[step], 1, -1.0, states[step + 1], False, step == EPISODE - 1)
                writer.end_episode(0, cut=False)


def convert(folder: Path) -> None:
    """Convert the logs in a folder, in this process."""
    convert_recording(
        folder / "raw", folder / "tables", folder / "reports", PARAMS.convert, cores=1, progress=lambda _n: None
    )


def main() -> None:
    """Print peaks in megabytes."""
    base, peak = peak_megabytes(nothing), peak_megabytes(train, 1_000_000)
    print(f"training on 1M transitions: {peak:6.0f} MB, {base:.0f} of them imports (target 1500 MB)")
    for shards, transitions in ((1, 50_000), (4, 50_000), (1, 200_000)):
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "raw").mkdir()
            write_shards(folder / "raw", shards, transitions)
            print(f"converting {shards} shards of {transitions:7,d}: {peak_megabytes(convert, folder):6.0f} MB")


if __name__ == "__main__":
    main()
