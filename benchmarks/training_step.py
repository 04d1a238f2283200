"""One update of all members at once, against a loop over n networks and against the matrix products alone."""

from collections.abc import Callable
from itertools import pairwise
from typing import Literal

import torch
from measuring import median_ratio, print_table, take_turns
from torch import Tensor, nn

from addressed_dynamics.models.stacked import StackedMLP
from addressed_dynamics.params import OptimiserParams
from addressed_dynamics.training.losses import squared_error
from addressed_dynamics.training.runtime import prepare_torch
from addressed_dynamics.training.update import StackTrainer

BATCH = 32
ROUNDS = 15
OPTIMISER = OptimiserParams(learning_rate=1e-4, betas=(0.9, 0.99), final_share=1.0)
Step = Callable[[], object]


def stacked_step(
    members: int, widths: tuple[int, ...], activation: Literal["relu", "tanh"], x: Tensor, y: Tensor
) -> Step:
    """Return an update of the stack."""
    stack = StackedMLP(members, widths, activation, torch.Generator().manual_seed(0))
    trainer = StackTrainer(stack, squared_error, OPTIMISER, total_updates=1_000_000)
    weight = torch.full((members, BATCH), 1 / BATCH)
    return lambda: trainer.update(x, y, weight)


def looped_step(members: int, widths: tuple[int, ...], activation: str, x: Tensor, y: Tensor) -> Step:
    """Return an update of as many networks, one after the other, as one would write it."""
    networks = []
    for _ in range(members):
        layers: list[nn.Module] = []
        for inputs, outputs in pairwise(widths):
            layers += [nn.Linear(inputs, outputs), {"relu": nn.ReLU, "tanh": nn.Tanh}[activation]()]
        networks.append(nn.Sequential(*layers[:-1]))
    optimisers = [torch.optim.Adam(network.parameters(), lr=1e-4, betas=(0.9, 0.99)) for network in networks]

    def step() -> None:
        for network, optimiser, own_x, own_y in zip(networks, optimisers, x, y, strict=True):
            optimiser.zero_grad()
            nn.functional.mse_loss(network(own_x), own_y).backward()
            optimiser.step()

    return step


def products(members: int, widths: tuple[int, ...]) -> Step:
    """Return the matrix products of an update and nothing else: forward, by the weights, by the inputs."""
    weights = [torch.randn(members, inputs, outputs) for inputs, outputs in pairwise(widths)]
    values = [torch.randn(members, BATCH, width) for width in widths]

    def step() -> None:
        for layer, weight in enumerate(weights):
            torch.bmm(values[layer], weight)
            torch.bmm(values[layer].transpose(1, 2), values[layer + 1])
            if layer:
                torch.bmm(values[layer + 1], weight.transpose(1, 2))

    return step


def main() -> None:
    """Print the time of an update, and the ratios."""
    prepare_torch(threads=1)
    rows = []
    cases: list[tuple[int, tuple[int, ...], Literal["relu", "tanh"], int, float]] = [
        (2, (5, 128, 128, 2), "relu", 300, 2.4),
        (8, (54, 256, 256, 256, 4), "tanh", 30, 2.5),
    ]
    for members, widths, activation, calls, target in cases:
        x, y = torch.randn(members, BATCH, widths[0]), torch.randn(members, BATCH, widths[-1])
        contestants = {
            "ours": stacked_step(members, widths, activation, x, y),
            "loop": looped_step(members, widths, activation, x, y),
            "products": products(members, widths),
        }
        seconds = take_turns(contestants, rounds=ROUNDS, calls=calls)
        ours = seconds["ours"].wall
        faster = median_ratio(seconds["loop"].wall, ours)
        floor = median_ratio(ours, seconds["products"].wall)
        shape = "-".join(map(str, widths))
        rows.append([
            f"n={members} {shape} {activation}, B={BATCH}", f"{1e6 * min(ours):.0f} µs",
            f"{faster:.1f}x faster (target: {target})", f"{floor:.1f}x",
        ])  # fmt: skip
    print_table(["networks", "ours", "than a loop of Sequential + Adam", "of the products alone"], rows)


if __name__ == "__main__":
    main()
