"""What is evaluated gives what was trained gives, by whichever way a batch goes."""

import numpy as np
import pytest
import torch

from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.networks import frozen
from addressed_dynamics.networks.addressing import addressing_scores
from addressed_dynamics.networks.frozen import FrozenMLP
from addressed_dynamics.networks.stacked import StackedMLP

STACKS = pytest.mark.parametrize(
    ("members", "activation", "shared", "linear"),
    [
        (1, "tanh", 0, False),
        (3, "relu", 0, False),
        (3, "elu", 0, True),
        (4, "tanh", 1, False),
        (2, "relu", 2, True),
    ],
)
BY = pytest.mark.parametrize(
    ("small", "few"), [(10**9, 16), (0, 0), (0, 16)], ids=["NumPy", "PyTorch", "PyTorch, few outputs"]
)
CLOSE = {"rtol": 1e-5, "atol": 1e-6}


def made(members: int, activation: Activation, shared: int, linear: bool) -> StackedMLP:
    generator = torch.Generator().manual_seed(1)
    stack = StackedMLP(members, (5, 16, 16, 2), activation, generator, shared=shared, linear=linear)
    for weight in stack.linear:
        torch.nn.init.normal_(weight, generator=generator)
    return stack.requires_grad_(requires_grad=False)


def inputs(rows: int) -> torch.Tensor:
    return torch.randn(rows, 5, generator=torch.Generator().manual_seed(rows))


@STACKS
@pytest.mark.parametrize("rows", [0, 1, 2, 37])
@BY
def test_it_gives_what_the_stack_gives(
    members: int,
    activation: Activation,
    shared: int,
    linear: bool,
    rows: int,
    small: int,
    few: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(frozen, "SMALL", small)
    monkeypatch.setattr(frozen, "FEW", few)
    stack = made(members, activation, shared, linear)
    found, x = FrozenMLP(stack), inputs(rows)
    member = torch.arange(rows) % members
    coefficients = torch.softmax(torch.randn(rows, members, generator=torch.Generator().manual_seed(2)), dim=1)
    torch.testing.assert_close(found.forward_all(x), stack.forward_all(x), **CLOSE)
    routed = found.forward_routed(x.numpy(), member.numpy())
    np.testing.assert_allclose(routed, stack.forward_routed(x, member).numpy(), **CLOSE)
    torch.testing.assert_close(found.forward_blended(x, coefficients), stack.forward_blended(x, coefficients), **CLOSE)
    assert torch.equal(x, inputs(rows))


@pytest.mark.parametrize("rows", [1, 30])
@pytest.mark.parametrize(("members", "outputs", "shared"), [(1, 3, 0), (3, 1, 1)])
@BY
def test_the_scores_are_those_of_the_stack(
    members: int, outputs: int, shared: int, rows: int, small: int, few: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(frozen, "SMALL", small)
    monkeypatch.setattr(frozen, "FEW", few)
    generator = torch.Generator().manual_seed(3)
    stack = StackedMLP(members, (5, 8, 8, outputs), "relu", generator, shared=shared).requires_grad_(False)
    found, x = FrozenMLP(stack), inputs(rows)
    np.testing.assert_allclose(found.scores(x.numpy()), addressing_scores(stack, x).numpy(), **CLOSE)


def test_what_is_made_in_inference_mode_can_be_used_outside_of_it() -> None:
    stack = made(2, "tanh", 0, False)
    with torch.inference_mode():
        found = FrozenMLP(stack)
    x = inputs(3).requires_grad_()
    found.forward_all(x).sum().backward()
    assert x.grad is not None
