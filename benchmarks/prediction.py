"""What `predict` and `rollout` cost beside the products of matrices that they cannot do without.

The products are `torch.mm` of rows and weights. `columns` are the same, but those of few outputs, with which MKL is
slow, are of weights and columns: the least that is known for these shapes on one thread.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
import torch
from measuring import median_ratio, print_table, take_turns
from trust import network, transitions

from addressed_dynamics.base.torch_runtime import prepare_torch
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.frozen import FEW
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import FeatureParams

ROUNDS = 60
STEPS = 200
TARGETS = {64: "1.8"}
"""Times the products that `predict` may cost, by the size of the batch."""


def main() -> None:
    """Print times and ratios for models of the sizes of MountainCar's and Acrobot's at the quick scale."""
    prepare_torch(threads=1)
    rows = []
    for name, model in {"MountainCar": mountain_car(), "as Acrobot": as_acrobot()}.items():
        for batch in (1, 64, 200, 1024):
            contestants = {**products_of(model, batch), "predict": predict_of(model, batch)}
            readings = take_turns(contestants, rounds=ROUNDS, calls=max(1, 40 // batch))
            ratio = median_ratio(readings["predict"].cpu, readings["products"].cpu)
            times = [f"{1e6 * min(each.cpu):,.0f} us" for each in readings.values()]
            rows.append([f"{name}, B = {batch:,}", *times, f"{ratio:.2f}", TARGETS.get(batch, "")])
        readings = take_turns({**products_of(model, STEPS), "rollout": rollout_of(model)}, rounds=5)
        seconds = min(readings["rollout"].cpu)
        rows.append(
            [
                f"{name}, rollout of {STEPS} x {STEPS} ({STEPS**2 / seconds:,.0f} steps/s), a step",
                *(f"{1e6 * min(readings[each].cpu):,.0f} us" for each in ("products", "columns")),
                f"{1e6 * seconds / STEPS:,.0f} us",
                f"{seconds / STEPS / min(readings['products'].cpu):.2f}",
                "",
            ]
        )
    print_table(["one thread", "products", "columns", "this", "ratio", "at most"], rows)


def mountain_car() -> AddressedDynamics:
    """Return two members of 128-128 and an addressing network of 128-128-64."""
    return network(fit_features(transitions(20, 0), FeatureParams(target="change")), 0)


def as_acrobot() -> AddressedDynamics:
    """Return eight members of three layers of 256, addressed by 256-256, which are given six frames."""
    features = fit_features(transitions(20, 0), FeatureParams(target="change", history=6))
    generator = torch.Generator().manual_seed(0)
    ensemble = StackedMLP(8, (features.inputs, 256, 256, 256, features.outputs), "relu", generator)
    addressing = StackedMLP(1, (features.inputs, 256, 256, 8), "relu", generator)
    for each in (ensemble, addressing):
        each.requires_grad_(requires_grad=False)
    return AddressedDynamics(features, ensemble, addressing)


def products_of(model: AddressedDynamics, batch: int) -> dict[str, Callable[[], None]]:
    """Return the products of the addressing network and of one member, at these shapes, without anything else."""
    assert model.addressing is not None
    shapes = [*model.addressing.weights, *model.ensemble.weights]
    given = [
        (torch.randn(batch, weight.shape[1]), weight[0].contiguous(), torch.empty(batch, weight.shape[2]))
        for weight in shapes
    ]

    best = [
        (weight.T.contiguous(), x.T, out.T.contiguous()) if weight.shape[1] < FEW else (x, weight, out)
        for x, weight, out in given
    ]

    def multiply(factors: list[tuple[torch.Tensor, torch.Tensor, torch.Tensor]]) -> None:
        for left, right, out in factors:
            torch.mm(left, right, out=out)

    return {"products": partial(multiply, given), "columns": partial(multiply, best)}


def predict_of(model: AddressedDynamics, batch: int) -> Callable[[], object]:
    """Return a prediction of so many states at a time."""
    states, actions = some(model, batch, model.features.history)
    given = (states, actions) if model.features.history > 1 else (states[:, 0], actions[:, 0])
    return lambda: model.predict(*given)


def rollout_of(model: AddressedDynamics) -> Callable[[], object]:
    """Return rollouts of `STEPS` steps of as many states."""
    history = model.features.history
    states, actions = some(model, STEPS, history - 1 + STEPS)
    first = states[:, :history] if history > 1 else states[:, 0]
    return lambda: model.rollout(first, actions)


def some(model: AddressedDynamics, batch: int, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Return states and actions in random order: what a model costs does not depend on them."""
    generator = np.random.default_rng(0)
    low, high = np.array([(each.low, each.high) for each in model.features.spaces.observation]).T
    states = generator.uniform(low, high, (batch, frames, len(low))).astype(np.float32)
    return states, generator.integers(0, 3, (batch, frames))


if __name__ == "__main__":
    main()
