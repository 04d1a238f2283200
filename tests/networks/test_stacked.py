import math
from collections.abc import Callable

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.utils.flop_counter import FlopCounterMode

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.params.training import Activation
from addressed_dynamics.networks.stacked import StackedMLP, in_chunks

SHARED = pytest.mark.parametrize("shared", [0, 1, 2])
LINEAR = pytest.mark.parametrize("linear", [False, True])


def make_stack(
    members: int = 3, activation: Activation = "tanh", shared: int = 0, *, linear: bool = False
) -> StackedMLP:
    generator = torch.Generator().manual_seed(0)
    stack = StackedMLP(members, (5, 16, 16, 2), activation, generator, shared=shared, linear=linear)
    for weight in stack.linear:
        torch.nn.init.normal_(weight, generator=generator)
    return stack


def one_member(stack: StackedMLP, member: int, x: torch.Tensor) -> torch.Tensor:
    """Evaluate one member layer by layer in float64: the oracle."""
    hidden = x.double()
    activate = {"relu": torch.relu, "tanh": torch.tanh, "elu": torch.nn.functional.elu}[stack.activation]
    last = len(stack.weights) - 1
    for layer in range(last + 1):
        own = 0 if layer < stack.shared else member
        hidden = hidden @ stack.weights[layer][own].double() + stack.biases[layer][own].double()
        hidden = activate(hidden) if layer < last else hidden
    for weight in stack.linear:
        hidden = hidden + x.double() @ weight[member].double()
    return hidden.float()


@SHARED
@LINEAR
@pytest.mark.parametrize("activation", ["relu", "tanh", "elu"])
def test_every_member_gives_what_it_would_give_alone(activation: str, shared: int, linear: bool) -> None:
    stack, x = make_stack(activation=activation, shared=shared, linear=linear), torch.randn(7, 5)
    for member in range(3):
        torch.testing.assert_close(stack(x)[member], one_member(stack, member, x))


@SHARED
@LINEAR
def test_members_can_have_inputs_of_their_own(shared: int, linear: bool) -> None:
    stack, x = make_stack(shared=shared, linear=linear), torch.randn(3, 7, 5)
    torch.testing.assert_close(stack(x)[1], stack(x[1])[1])


@settings(max_examples=25)
@given(st.lists(st.integers(0, 2), max_size=12), st.integers(0, 2), st.booleans())
def test_routing_gives_each_sample_the_output_of_its_own_member(member: list[int], shared: int, linear: bool) -> None:
    stack, x = make_stack(shared=shared, linear=linear), torch.randn(len(member), 5)
    routed = stack.forward_routed(x, torch.tensor(member, dtype=torch.int64))
    expected = stack(x)[member, torch.arange(len(member))]
    torch.testing.assert_close(routed, expected)


@SHARED
@LINEAR
def test_blending_with_one_hot_coefficients_is_routing(shared: int, linear: bool) -> None:
    stack, x, member = make_stack(shared=shared, linear=linear), torch.randn(6, 5), torch.tensor([0, 1, 2, 2, 1, 0])
    blended = stack.forward_blended(x, torch.nn.functional.one_hot(member, 3).float())
    torch.testing.assert_close(blended, stack.forward_routed(x, member))


@LINEAR
@pytest.mark.parametrize("shared", [0, 1])
def test_blending_mixes_parameters_not_outputs(shared: int, linear: bool) -> None:
    stack, x = make_stack(shared=shared, linear=linear), torch.randn(4, 5)
    mixed = StackedMLP(1, stack.widths, stack.activation, linear=linear)
    for target, source in zip(mixed.parameters(), stack.parameters(), strict=True):
        # The coefficients add up to 1, so a layer that all members share is what it is.
        target.data = (source * torch.tensor([0.5, 0.3, 0.2]).view(3, 1, 1)).sum(dim=0, keepdim=True).detach()
    blended = stack.forward_blended(x, torch.tensor([[0.5, 0.3, 0.2]]).expand(4, 3))
    torch.testing.assert_close(blended, mixed(x)[0])
    assert not torch.allclose(blended, (stack(x) * torch.tensor([0.5, 0.3, 0.2]).view(3, 1, 1)).sum(dim=0))


def test_initial_weights_follow_the_generator_alone() -> None:
    torch.manual_seed(1)
    first = make_stack()
    torch.manual_seed(2)
    second = make_stack()
    assert all(torch.equal(a, b) for a, b in zip(first.parameters(), second.parameters(), strict=True))


@SHARED
def test_initial_weights_are_drawn_layer_by_layer(shared: int) -> None:
    stack, generator = make_stack(shared=shared), torch.Generator().manual_seed(0)
    for layer, (inputs, outputs) in enumerate([(5, 16), (16, 16), (16, 2)]):
        bound, copies = 1 / math.sqrt(inputs), 1 if layer < shared else 3
        for parameter, rows in ((stack.weights[layer], inputs), (stack.biases[layer], 1)):
            drawn = torch.empty(copies, rows, outputs).uniform_(-bound, bound, generator=generator)
            assert torch.equal(parameter, drawn)


def test_parameters_are_counted_per_member_and_in_total() -> None:
    first, second, last = (5 + 1) * 16, (16 + 1) * 16, (16 + 1) * 2
    stacks = [make_stack(shared=shared) for shared in range(3)]
    assert [stack.parameters_per_member for stack in stacks] == [first + second + last] * 3
    totals = [3 * (first + second + last), first + 3 * (second + last), first + second + 3 * last]
    assert [stack.parameters_total for stack in stacks] == totals
    assert make_stack(linear=True).parameters_per_member == first + second + last + 5 * 2
    assert make_stack(linear=True).parameters_total == 3 * (first + second + last + 5 * 2)


def test_a_linear_part_changes_nothing_at_first_nor_the_weights_that_are_drawn() -> None:
    stacks = [
        StackedMLP(3, (5, 16, 2), "tanh", torch.Generator().manual_seed(0), linear=linear) for linear in (False, True)
    ]
    x = torch.randn(6, 5)
    assert torch.equal(stacks[0](x), stacks[1](x))


def test_chunks_give_what_one_pass_gives() -> None:
    stack, x = make_stack(), torch.randn(20_000, 5)
    torch.testing.assert_close(in_chunks(stack.forward_all, x, sample_dim=1), stack(x).detach())


def test_inputs_of_the_wrong_width_are_refused() -> None:
    with pytest.raises(ModelError, match="takes 5 inputs, but was given 4"):
        make_stack()(torch.zeros(3, 4))


@pytest.mark.parametrize("shared", [-1, 3])
def test_members_that_share_all_of_their_layers_are_refused(shared: int) -> None:
    with pytest.raises(ModelError, match=f"of 3 layers, 0 to 2 can be shared by all members, but not {shared}"):
        make_stack(shared=shared)


def test_a_stack_without_members_is_refused() -> None:
    with pytest.raises(ModelError, match="members >= 1"):
        StackedMLP(0, (5, 2), "relu")


def products_of(call: Callable[[], torch.Tensor]) -> int:
    """How many products the matrix products of `call` make, by PyTorch's own count of two operations each."""
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        call()
    return int(counter.get_total_flops()) // 2


@SHARED
@LINEAR
def test_multiply_adds_are_those_that_pytorch_counts(shared: int, linear: bool) -> None:
    stack, x = make_stack(shared=shared, linear=linear), torch.randn(1, 5)
    one = torch.zeros(1, dtype=torch.int64)
    assert stack.multiply_adds() == products_of(lambda: stack(x))
    assert stack.multiply_adds(members=1) == products_of(lambda: stack.forward_routed(x, one))
    mixing = 3 * sum(stack.widths[1 + shared :])
    blended = products_of(lambda: stack.forward_blended(x, torch.full((1, 3), 1 / 3)))
    assert stack.multiply_adds_blended == blended + mixing


def test_multiply_adds_of_known_networks() -> None:
    stack = StackedMLP(4, (5, 16, 8, 2), "relu")
    assert stack.multiply_adds(members=1) == 5 * 16 + 16 * 8 + 8 * 2
    assert stack.multiply_adds() == 4 * (5 * 16 + 16 * 8 + 8 * 2)
    assert stack.multiply_adds_blended == stack.multiply_adds() + 4 * (16 + 8 + 2)
    assert StackedMLP(4, (5, 16, 8, 2), "relu", shared=1).multiply_adds() == 5 * 16 + 4 * (16 * 8 + 8 * 2)
