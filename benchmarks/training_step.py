"""One update of all members against a loop over nn.Sequential with Adam, and against the matrix products alone."""

import itertools
from collections.abc import Callable

import torch
from rounds import fastest
from torch import nn

from addressed_dynamics.models.stacked import Activation, StackedMLP
from addressed_dynamics.params import OptimiserParams
from addressed_dynamics.training.losses import squared_error
from addressed_dynamics.training.runtime import prepare_torch
from addressed_dynamics.training.update import StackTrainer

MODULES: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "tanh": nn.Tanh}
CASES: list[tuple[str, int, tuple[int, ...], Activation, int, float | None]] = [
    ("MountainCar, B=32", 2, (5, 128, 128, 2), "relu", 32, 2.4),
    ("MountainCar, B=64 (params.yaml)", 2, (5, 128, 128, 2), "relu", 64, None),
    ("Acrobot, B=32", 8, (54, 256, 256, 256, 4), "tanh", 32, 2.5),
]


def stacked(
    members: int, widths: tuple[int, ...], activation: Activation, x: torch.Tensor, y: torch.Tensor
) -> Callable[[], object]:
    """Return this project's update."""
    stack = StackedMLP(members, widths, activation, torch.Generator().manual_seed(0))
    optimiser = OptimiserParams(learning_rate=1e-4, betas=(0.9, 0.99), final_share=1.0)
    trainer = StackTrainer(stack, squared_error, optimiser, 1)
    weight = torch.full(x.shape[:2], 1.0 / x.shape[1])
    return lambda: trainer.update(x, y, weight)


def loop(
    members: int, widths: tuple[int, ...], activation: Activation, x: torch.Tensor, y: torch.Tensor
) -> Callable[[], object]:
    """Return the same update as one would write it first: one network after the other."""
    networks, optimisers = [], []
    for _ in range(members):
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(widths):
            layers += [nn.Linear(inputs, outputs), MODULES[activation]()]
        networks.append(nn.Sequential(*layers[:-1]))
        optimisers.append(torch.optim.Adam(networks[-1].parameters(), lr=1e-4, betas=(0.9, 0.99)))

    def update() -> None:
        for member, (network, optimiser) in enumerate(zip(networks, optimisers, strict=True)):
            optimiser.zero_grad()
            nn.functional.mse_loss(network(x[member]), y[member]).backward()
            optimiser.step()

    return update


def products(members: int, widths: tuple[int, ...], batch: int) -> Callable[[], object]:
    """Return the matrix products of an update and nothing else: forward, and both gradients of every layer."""
    shapes = list(itertools.pairwise(widths))
    inputs = [torch.randn(members, batch, i) for i, _ in shapes]
    outputs = [torch.randn(members, batch, o) for _, o in shapes]
    weights = [torch.randn(members, i, o) for i, o in shapes]

    def multiply() -> None:
        for layer, (x, weight, derivative) in enumerate(zip(inputs, weights, outputs, strict=True)):
            torch.bmm(x, weight)
            torch.bmm(x.transpose(1, 2), derivative)
            if layer:
                torch.bmm(derivative, weight.transpose(1, 2))

    return multiply


def main() -> None:
    """Print one line for each shape."""
    prepare_torch(threads=1)
    print(f"{'shape':>32}  {'µs':>7}  {'loop':>9}  {'target':>6}  {'of the products':>15}")
    for name, members, widths, activation, batch, target in CASES:
        x, y = torch.randn(members, batch, widths[0]), torch.randn(members, batch, widths[-1])
        best = fastest(
            {
                "stacked": stacked(members, widths, activation, x, y),
                "loop": loop(members, widths, activation, x, y),
                "products": products(members, widths, batch),
            },
            rounds=30,
            repeats=20,
        )
        ratios = (
            f"{best['loop'] / best['stacked']:7.2f}x  {target or '-':>6}  {best['stacked'] / best['products']:14.2f}x"
        )
        print(f"{name:>32}  {best['stacked'] * 1e6:7.0f}  {ratios}")


if __name__ == "__main__":
    main()
