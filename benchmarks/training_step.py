"""One update of all members at once, against a loop over n networks, autograd on the stack, and the products alone."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import torch
from measuring import median_ratio, print_table, take_turns
from torch import Tensor, nn

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.torch_runtime import CPU, prepare_torch
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.networks.stacked import Activation, StackedMLP
from addressed_dynamics.training.losses import cross_entropy_of_heads, squared_error
from addressed_dynamics.training.update import StackTrainer

ROUNDS = 15
OPTIMISER = OptimiserParams(learning_rate=1e-4, betas=(0.9, 0.99), final_share=1.0)
Step = Callable[[], object]


@dataclass(frozen=True)
class Case:
    """Networks to train, and on how much."""

    name: str
    """What they are for."""
    members: int
    """Number of networks, or of heads."""
    widths: tuple[int, ...]
    """Inputs, hidden layers, outputs."""
    activation: Activation
    """Nonlinearity."""
    batch: int
    """Samples per member."""
    calls: int
    """Updates in a round."""
    shared: int = 0
    """Layers of the trunk; if there are any, the heads have one softmax and learn classes."""
    target: float | None = None
    """How many times faster than the loop an update should be, if that was promised."""

    def stack(self) -> StackedMLP:
        """Return the networks as one stack."""
        generator = torch.Generator().manual_seed(0)
        return StackedMLP(self.members, self.widths, self.activation, generator, shared=self.shared)

    def batches(self) -> tuple[Tensor, Tensor]:
        """Return inputs and targets: (member, sample, ...), or (1, sample, ...) for heads on a trunk."""
        if self.shared:
            return torch.randn(1, self.batch, self.widths[0]), torch.randint(0, self.members, (1, self.batch))
        shape = (self.members, self.batch)
        return torch.randn(*shape, self.widths[0]), torch.randn(*shape, self.widths[-1])


CASES = [
    Case("MountainCar", 2, (5, 128, 128, 2), "relu", 32, 300, target=2.4),
    *(Case("Acrobot", 8, (54, 256, 256, 256, 4), "tanh", batch, 960 // batch, target=target)
      for batch, target in ((32, 2.5), (128, None))),
    *(Case("Acrobot addressing", 8, (54, 512, 512, 256, 256, 1), "tanh", batch, max(1, 640 // batch), shared=2)
      for batch in (32, 128, 512)),
    Case("Motion", 4, (342, 512, 512, 311), "elu", 32, 8, target=1.8),
]  # fmt: skip
"""What this project trains."""


def stacked_step(case: Case, x: Tensor, y: Tensor) -> Step:
    """Return an update as this project makes it, where the batch is."""
    loss = cross_entropy_of_heads if case.shared else squared_error
    trainer = StackTrainer(case.stack().on(x.device), loss, OPTIMISER, total_updates=1_000_000)
    weight = torch.full(x.shape[:2], 1 / case.batch, device=x.device)
    return lambda: trainer.update(x, y, weight)


def autograd_step(case: Case, x: Tensor, y: Tensor) -> Step:
    """Return an update of the same stack by autograd and PyTorch's fastest Adam."""
    stack = case.stack()
    optimiser = torch.optim.Adam(stack.parameters(), lr=1e-4, betas=(0.9, 0.99), fused=True)

    def step() -> None:
        optimiser.zero_grad()
        if case.shared:
            loss = nn.functional.cross_entropy(addressing_scores(stack, x[0]), y[0])
        else:
            loss = nn.functional.mse_loss(stack(x), y, reduction="sum") / y[0].numel()
        loss.backward()
        optimiser.step()

    return step


def looped_step(case: Case, x: Tensor, y: Tensor) -> Step:
    """Return an update of as many networks, one after the other, as one would write it."""
    if case.shared:
        trunk = sequential(case.widths[: case.shared + 1], case.activation, last=True)
        heads = nn.ModuleList(sequential(case.widths[case.shared :], case.activation) for _ in range(case.members))
        together = torch.optim.Adam([*trunk.parameters(), *heads.parameters()], lr=1e-4, betas=(0.9, 0.99))

        def step_of_heads() -> None:
            together.zero_grad()
            hidden = trunk(x[0])
            scores = torch.cat([head(hidden) for head in heads], dim=1)
            nn.functional.cross_entropy(scores, y[0]).backward()
            together.step()

        return step_of_heads

    networks = [sequential(case.widths, case.activation).to(x.device) for _ in range(case.members)]
    optimisers = [torch.optim.Adam(network.parameters(), lr=1e-4, betas=(0.9, 0.99)) for network in networks]

    def step() -> None:
        for network, optimiser, own_x, own_y in zip(networks, optimisers, x, y, strict=True):
            optimiser.zero_grad()
            nn.functional.mse_loss(network(own_x), own_y).backward()
            optimiser.step()

    return step


def sequential(widths: tuple[int, ...], activation: Activation, *, last: bool = False) -> nn.Sequential:
    """Return one network, with or without an activation after its last layer."""
    layers: list[nn.Module] = []
    for inputs, outputs in pairwise(widths):
        layers += [nn.Linear(inputs, outputs), {"relu": nn.ReLU, "tanh": nn.Tanh, "elu": nn.ELU}[activation]()]
    return nn.Sequential(*(layers if last else layers[:-1]))


def products(case: Case, device: torch.device = CPU) -> Step:
    """Return the matrix products of an update and nothing else: forward, by the weights, by the inputs."""
    weights = [weight.detach() for weight in case.stack().on(device).weights]
    inputs = [torch.randn(len(weight), case.batch, weight.shape[1], device=device) for weight in weights]
    derivatives = [torch.randn(len(weight), case.batch, weight.shape[2], device=device) for weight in weights]

    def step() -> None:
        for layer, (values, derivative, weight) in enumerate(zip(inputs, derivatives, weights, strict=True)):
            torch.bmm(values, weight)
            torch.bmm(values.transpose(1, 2), derivative)
            if layer:
                torch.bmm(derivative, weight.transpose(1, 2))

    return step


def main() -> None:
    """Print the time of an update, and the ratios."""
    prepare_torch(threads=1)
    rows = []
    for case in CASES:
        x, y = case.batches()
        contestants = {
            "ours": stacked_step(case, x, y),
            "loop": looped_step(case, x, y),
            "autograd": autograd_step(case, x, y),
            "products": products(case),
        }
        seconds = take_turns(contestants, rounds=ROUNDS, calls=case.calls)
        ours = seconds["ours"].wall
        faster = {name: median_ratio(seconds[name].wall, ours) for name in ("loop", "autograd")}
        floor = median_ratio(ours, seconds["products"].wall)
        target = f" (target: {case.target})" if case.target else ""
        rows.append([
            f"{case.name}: n={case.members} {'-'.join(map(str, case.widths))} {case.activation}, B={case.batch}",
            f"{1e6 * min(ours):.0f} µs", f"{faster['loop']:.1f}x faster{target}", f"{faster['autograd']:.1f}x faster",
            f"{floor:.1f}x",
        ])  # fmt: skip
    headings = ["networks", "ours", "than a loop of Sequential + Adam", "than autograd", "of the products alone"]
    print_table(headings, rows)


if __name__ == "__main__":
    main()
