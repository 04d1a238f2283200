"""Training, Algorithm 1 and rollouts on a GPU, against a loop of networks, the products alone, and one sort.

    python benchmarks/gpu.py --figures docs/figures/gpu.json

Without a GPU it says so, and measures nothing. With `--device cpu` all of it runs at small sizes, to see that it does.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from measuring import median_ratio, print_table, take_turns
from prediction import as_acrobot
from training_step import Case, Step, looped_step, products, stacked_step

from addressed_dynamics.base.errors import DeviceError
from addressed_dynamics.base.torch_runtime import CPU, DEVICE, checked_device, prepare_torch
from addressed_dynamics.simulators.on_device import ModelOnDevice
from addressed_dynamics.training.clustering import assign_to_bins

PRODUCTS_TARGET = 2.0
"""Times the products that an update may cost at the largest batch."""
COMPARED = 1_000_000
"""Loss profiles of which the bins are held against the CPU's."""


@dataclass(frozen=True)
class Sizes:
    """How much is measured."""

    batches: tuple[int, ...] = (32, 4096)
    """Samples per member of an update."""
    profiles: int = 100_000_000
    """Loss profiles of eight members."""
    rollouts: int = 65_536
    """Rollouts at once."""
    steps: int = 1_000
    """Steps of each."""
    rounds: int = 15
    """Rounds in which contestants take turns."""
    seconds: float = 0.2
    """About how long an update is repeated in a round, so that the clock's own cost does not count."""


SMALL = Sizes((2, 4), 1_000, 8, 3, rounds=1, seconds=0.0)
"""To see that everything runs."""


def main(arguments: Sequence[str] | None = None, small: Sizes = SMALL) -> None:
    """Print the times and ratios, and write them as figures for docs/results.md."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cuda", help="cuda, cuda:1, or cpu for a trial at small sizes")
    parser.add_argument("--figures", type=Path, help="where the figures for docs/results.md go, as JSON")
    options = parser.parse_args(arguments)
    try:
        device = checked_device(options.device, "--device", "give --device cpu")
    except DeviceError as error:
        print(f"nothing was measured: {error}")
        return
    # Products of float32 and sums in a fixed order, as the trainings have them.
    os.environ[DEVICE] = str(device)
    prepare_torch(threads=1)
    sizes = small if device == CPU else Sizes()
    found = {
        "card": card(device),
        "torch": torch.__version__,
        "updates": [update(device, batch, sizes) for batch in sizes.batches],
        "algorithm_1": algorithm_1(device, sizes),
        "rollouts": rollouts(device, sizes),
    }
    show(found)
    if options.figures:
        options.figures.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


def card(device: torch.device) -> str:
    """Return what computes."""
    return platform.processor() or "CPU" if device == CPU else torch.cuda.get_device_name(device)


def waits_for(device: torch.device) -> Callable[[], None]:
    """Return what waits until a device has done everything."""
    return (lambda: None) if device == CPU else lambda: torch.cuda.synchronize(device)


def in_a_row(step: Step, calls: int, wait: Callable[[], None]) -> Step:
    """Return a step that is made so many times, and waited for once."""

    def steps() -> None:
        for _ in range(calls):
            step()
        wait()

    return steps


def as_graph(step: Step, device: torch.device) -> Step:
    """Return a step as a CUDA graph, so that its launches cost nothing; on the CPU as it is."""
    if device == CPU:
        return step
    step()
    torch.cuda.synchronize(device)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        step()
    return graph.replay


def update(device: torch.device, batch: int, sizes: Sizes) -> dict[str, Any]:
    """Return the time of an update of eight networks of Acrobot's size, and the ratios to others."""
    case = Case("Acrobot", 8, (54, 256, 256, 256, 4), "tanh", batch, 1)
    x, y = (each.to(device) for each in case.batches())
    contestants = {
        "ours": stacked_step(case, x, y),
        "loop": looped_step(case, x, y),
        "products": as_graph(products(case, device), device),
    }
    wait = waits_for(device)
    probe = take_turns({name: in_a_row(step, 3, wait) for name, step in contestants.items()}, rounds=1)
    calls = {name: max(int(sizes.seconds / (each.wall[0] / 3)), 1) for name, each in probe.items()}
    readings = take_turns(
        {name: in_a_row(step, calls[name], wait) for name, step in contestants.items()}, rounds=sizes.rounds
    )
    each = {name: [second / calls[name] for second in readings[name].wall] for name in contestants}
    return {
        "batch": batch,
        "microseconds": 1e6 * min(each["ours"]),
        "faster_than_loop": median_ratio(each["loop"], each["ours"]),
        "of_products": median_ratio(each["ours"], each["products"]),
    }


def algorithm_1(device: torch.device, sizes: Sizes) -> dict[str, Any]:
    """Return the time of Algorithm 1, of one sort of as many numbers, and whether bins are those of the CPU."""
    generator = torch.Generator(device).manual_seed(0)
    losses = torch.rand(sizes.profiles, 8, device=device, generator=generator).pow_(4)
    numbers = torch.rand(sizes.profiles, device=device, generator=generator)
    wait = waits_for(device)
    contestants: dict[str, Step] = {"ours": lambda: assign_to_bins(losses), "sort": lambda: torch.sort(numbers)}
    readings = take_turns(
        {name: in_a_row(step, 1, wait) for name, step in contestants.items()}, rounds=min(sizes.rounds, 3)
    )
    some = losses[:COMPARED]
    return {
        "profiles": sizes.profiles,
        "members": 8,
        "seconds": min(readings["ours"].wall),
        "sorts": median_ratio(readings["ours"].wall, readings["sort"].wall),
        "same_bins": torch.equal(assign_to_bins(some).cpu(), assign_to_bins(some.cpu())),
    }


def rollouts(device: torch.device, sizes: Sizes) -> dict[str, Any]:
    """Return how many states a model as large as Acrobot's predicts in a second, in many rollouts at once."""
    model = as_acrobot()
    features, history = model.features, model.features.history
    generator = torch.Generator().manual_seed(0)
    low, high = (torch.tensor([getattr(each, end) for each in features.spaces.observation]) for end in ("low", "high"))
    first = low + (high - low) * torch.rand(sizes.rollouts, history, len(low), generator=generator)
    actions = torch.randint(0, 3, (sizes.rollouts, history - 1 + sizes.steps), generator=generator)
    there = ModelOnDevice(model, device)
    given = first.to(device), actions.to(device)
    readings = take_turns(
        {"ours": in_a_row(lambda: there.rollout(*given), 1, waits_for(device))}, rounds=min(sizes.rounds, 3)
    )
    seconds = min(readings["ours"].wall)
    return {
        "rollouts": sizes.rollouts,
        "steps": sizes.steps,
        "seconds": seconds,
        "states_per_second": sizes.rollouts * sizes.steps / seconds,
    }


def show(found: dict[str, Any]) -> None:
    """Print what was measured."""
    last = found["updates"][-1]["batch"]
    rows = [
        [
            f"update, n=8 54-256x3-4, B={each['batch']:,}", f"{each['microseconds']:,.0f} µs",
            f"{each['faster_than_loop']:.1f}x faster than the loop",
            f"{each['of_products']:.2f}x of the products"
            + (f" (target: {PRODUCTS_TARGET:g})" if each["batch"] == last else ""),
        ]
        for each in found["updates"]
    ]  # fmt: skip
    bins, rolled = found["algorithm_1"], found["rollouts"]
    rows += [
        [f"Algorithm 1, {bins['profiles']:,} x {bins['members']}", f"{bins['seconds']:.3g} s",
         f"{bins['sorts']:.1f}x of one sort", f"same bins as on the CPU: {'yes' if bins['same_bins'] else 'NO'}"],
        [f"rollouts, {rolled['rollouts']:,} x {rolled['steps']:,}", f"{rolled['seconds']:.3g} s",
         f"{rolled['states_per_second']:,.0f} states/s", ""],
    ]  # fmt: skip
    print_table([f"{found['card']}, torch {found['torch']}", "time", "", ""], rows)


if __name__ == "__main__":
    main()
