import math

import pytest
import torch

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.networks.stacked import ACTIVATIONS, StackedMLP
from addressed_dynamics.training.losses import (
    absolute_and_squared_error,
    absolute_error,
    cross_entropy,
    cross_entropy_of_heads,
    squared_error,
)
from addressed_dynamics.training.update import StackTrainer

OPTIMISER = OptimiserParams(learning_rate=1e-2, betas=(0.9, 0.99), final_share=0.1)


def make_stack(
    members: int, activation: Activation, outputs: int = 2, seed: int = 0, shared: int = 0, *, linear: bool = False
) -> StackedMLP:
    generator = torch.Generator().manual_seed(seed)
    stack = StackedMLP(members, (5, 16, 8, outputs), activation, generator, shared=shared, linear=linear)
    for weight in stack.linear:
        torch.nn.init.normal_(weight, generator=generator)
    return stack


def batch(members: int, samples: int = 12, seed: int = 1) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    x = torch.randn(members, samples, 5, generator=generator)
    return x, torch.randn(members, samples, 2, generator=generator), torch.full((members, samples), 1 / samples)


def assert_gradients_are_of(trainer: StackTrainer, reference: StackedMLP) -> None:
    gradients = trainer._weight_gradients + trainer._bias_gradients + trainer._linear_gradients
    computed = torch.cat([gradient.flatten() for gradient in gradients])
    wanted = torch.cat([parameter.grad.flatten() for parameter in reference.parameters()])
    torch.testing.assert_close(computed, wanted, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("activation", ["relu", "tanh", "elu"])
@pytest.mark.parametrize("loss", ["mse", "mae", "cross_entropy"])
@pytest.mark.parametrize("shared", [0, 1, 2])
@pytest.mark.parametrize("linear", [False, True])
def test_gradients_equal_those_of_autograd(activation: str, loss: str, shared: int, linear: bool) -> None:
    stack, reference = (make_stack(3, activation, shared=shared, linear=linear) for _ in range(2))
    x, y, weight = batch(3)
    x = x[:1] if shared else x
    weight = weight * torch.rand(weight.shape)
    target = y.argmax(dim=-1) if loss == "cross_entropy" else y
    function = {"mse": squared_error, "mae": absolute_error, "cross_entropy": cross_entropy}[loss]
    trainer = StackTrainer(stack, function, OPTIMISER, 10)
    losses = trainer.gradients(x, target, weight)
    output = reference(x[0] if shared else x)
    if loss == "cross_entropy":
        per_sample = torch.nn.functional.cross_entropy(output.transpose(1, 2), target, reduction="none")
    else:
        per_sample = (output - y).square().mean(-1) if loss == "mse" else (output - y).abs().mean(-1)
    expected = (per_sample * weight).sum(dim=1)
    expected.sum().backward()
    torch.testing.assert_close(losses, expected.detach())
    assert_gradients_are_of(trainer, reference)


@pytest.mark.parametrize("activation", ["relu", "tanh", "elu"])
@pytest.mark.parametrize("shared", [0, 1, 2])
def test_gradients_with_dropout_equal_those_of_autograd_with_the_same_masks(activation: str, shared: int) -> None:
    stack, reference = (make_stack(3, activation, shared=shared) for _ in range(2))
    x, y, weight = batch(3)
    x = x[:1] if shared else x
    generator, same = (torch.Generator().manual_seed(5) for _ in range(2))
    trainer = StackTrainer(stack, squared_error, OPTIMISER, 10, dropout=0.4, generator=generator)
    losses = trainer.gradients(x, y, weight)
    hidden = x
    for layer, (weights, bias) in enumerate(zip(reference.weights, reference.biases, strict=True)):
        hidden = ACTIVATIONS[activation](hidden) if layer else hidden
        hidden = hidden * (torch.rand(hidden.shape, generator=same) < 0.6) / 0.6
        hidden = hidden @ weights + bias
    expected = ((hidden - y).square().mean(-1) * weight).sum(dim=1)
    expected.sum().backward()
    torch.testing.assert_close(losses, expected.detach())
    assert_gradients_are_of(trainer, reference)


@pytest.mark.parametrize("activation", ["relu", "tanh", "elu"])
@pytest.mark.parametrize("shared", [0, 1, 2])
def test_gradients_of_heads_that_share_a_softmax_equal_those_of_autograd(activation: str, shared: int) -> None:
    stack, reference = (make_stack(4, activation, outputs=1, shared=shared) for _ in range(2))
    x, _, weight = batch(1)
    weight = weight * torch.rand(weight.shape)
    target = torch.randint(0, 4, (1, 12))
    trainer = StackTrainer(stack, cross_entropy_of_heads, OPTIMISER, 10)
    losses = trainer.gradients(x, target, weight)
    scores = reference(x[0]).squeeze(-1).T
    expected = (torch.nn.functional.cross_entropy(scores, target[0], reduction="none") * weight[0]).sum()
    expected.backward()
    torch.testing.assert_close(losses, expected.detach().unsqueeze(0))
    assert_gradients_are_of(trainer, reference)


def test_training_all_members_at_once_gives_what_training_them_one_after_the_other_gives() -> None:
    together = make_stack(3, "relu")
    alone = [torch.nn.Sequential() for _ in range(3)]
    for member in range(3):
        layers: list[torch.nn.Module] = []
        for weight, bias in zip(together.weights, together.biases, strict=True):
            linear = torch.nn.Linear(*weight.shape[1:])
            linear.weight.data, linear.bias.data = weight[member].detach().T.clone(), bias[member, 0].detach().clone()
            layers += [linear, torch.nn.ReLU()]
        alone[member] = torch.nn.Sequential(*layers[:-1])
    trainer = StackTrainer(together, squared_error, OPTIMISER, 20)
    optimisers = [torch.optim.Adam(net.parameters(), lr=1e-2, betas=(0.9, 0.99)) for net in alone]
    for step in range(20):
        x, y, weight = batch(3, seed=step)
        share = 0.1 + 0.9 * 0.5 * (1 + math.cos(math.pi * step / 20))
        trainer.update(x, y, weight)
        for member, (net, optimiser) in enumerate(zip(alone, optimisers, strict=True)):
            optimiser.param_groups[0]["lr"] = 1e-2 * share
            optimiser.zero_grad()
            torch.nn.functional.mse_loss(net(x[member]), y[member]).backward()
            optimiser.step()
    x, _, _ = batch(3, seed=99)
    expected = torch.stack([net(x[member]) for member, net in enumerate(alone)])
    torch.testing.assert_close(together(x), expected, rtol=1e-4, atol=1e-5)


def test_a_restored_trainer_goes_on_bit_for_bit() -> None:
    straight = StackTrainer(make_stack(2, "tanh"), squared_error, OPTIMISER, 10)
    first = StackTrainer(make_stack(2, "tanh"), squared_error, OPTIMISER, 10)
    for step in range(10):
        straight.update(*batch(2, seed=step))
    for step in range(4):
        first.update(*batch(2, seed=step))
    second = StackTrainer(make_stack(2, "tanh", seed=5), squared_error, OPTIMISER, 10)
    second.restore(first.state())
    for step in range(4, 10):
        second.update(*batch(2, seed=step))
    for a, b in zip(straight.stack.parameters(), second.stack.parameters(), strict=True):
        assert torch.equal(a, b)


def test_the_learning_rate_falls_from_its_peak_to_its_final_share() -> None:
    trainer = StackTrainer(make_stack(1, "relu"), squared_error, OPTIMISER, 8)
    rates = []
    for step in range(9):
        rates.append(trainer.learning_rate)
        trainer.update(*batch(1, seed=step))
    assert rates[0] == pytest.approx(1e-2)
    assert rates[-1] == pytest.approx(1e-3)
    assert rates == sorted(rates, reverse=True)


def test_of_the_sum_of_both_errors_the_squared_one_is_reported_and_the_derivative_is_that_of_the_sum() -> None:
    output, target, weight = (torch.randn(3, 12, 2), torch.randn(3, 12, 2), torch.rand(3, 12))
    reported, derivative = absolute_and_squared_error(output, target, weight)
    output.requires_grad_()
    error = output - target
    squared = (error.square().mean(-1) * weight).sum(dim=1)
    (squared + (error.abs().mean(-1) * weight).sum(dim=1)).sum().backward()
    torch.testing.assert_close(reported, squared.detach())
    torch.testing.assert_close(derivative, output.grad)


def test_weight_decay_is_that_of_adamw() -> None:
    stack, reference = (make_stack(2, "tanh") for _ in range(2))
    constant = OPTIMISER.model_copy(update={"final_share": 1.0})
    trainer = StackTrainer(stack, squared_error, constant, 20, weight_decay=0.3)
    optimiser = torch.optim.AdamW(reference.parameters(), lr=1e-2, betas=(0.9, 0.99), weight_decay=0.3)
    for step in range(20):
        x, y, weight = batch(2, seed=step)
        trainer.update(x, y, weight)
        optimiser.zero_grad()
        ((reference(x) - y).square().mean(-1) * weight).sum().backward()
        optimiser.step()
    for found, expected in zip(stack.parameters(), reference.parameters(), strict=True):
        torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-6)


def test_a_linear_part_does_not_shrink() -> None:
    stack = make_stack(2, "tanh", linear=True)
    before = stack.linear[0].detach().clone()
    x, y, _ = batch(2)
    trainer = StackTrainer(stack, squared_error, OPTIMISER, 20, weight_decay=0.3)
    trainer.update(x, y, torch.zeros(2, 12))
    assert torch.equal(stack.linear[0], before)
    fresh = make_stack(2, "tanh", linear=True)
    torch.testing.assert_close(stack.weights[0], fresh.weights[0] * (1 - 0.3 * 1e-2))
