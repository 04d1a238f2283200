import pytest
import torch
from learning import drive, untrained_model

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.networks.addressing import Use, addressed_members, addressing_scores, multiply_adds_a_step
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.portable import StepModule

X = torch.randn(7, 5, generator=torch.Generator().manual_seed(1))
HEADS = StackedMLP(3, (5, 16, 8, 1), "tanh", torch.Generator().manual_seed(0), shared=1)
PLAIN = StackedMLP(1, (5, 16, 3), "tanh", torch.Generator().manual_seed(0))


def test_the_scores_of_a_plain_network_are_its_outputs() -> None:
    torch.testing.assert_close(addressing_scores(PLAIN, X), PLAIN(X)[0])
    assert addressing_scores(PLAIN, X).shape == (7, 3)


def test_the_score_of_a_member_is_the_output_of_its_head_on_the_trunk() -> None:
    trunk = torch.tanh(X @ HEADS.weights[0][0] + HEADS.biases[0][0])
    for member in range(3):
        hidden = torch.tanh(trunk @ HEADS.weights[1][member] + HEADS.biases[1][member])
        expected = hidden @ HEADS.weights[2][member] + HEADS.biases[2][member]
        torch.testing.assert_close(addressing_scores(HEADS, X)[:, member : member + 1], expected)


@pytest.mark.parametrize(
    ("network", "members"),
    [(PLAIN, 3), (HEADS, 3), (StackedMLP(1, (5, 4, 1), "relu", shared=1), 1), (StackedMLP(2, (5, 3), "relu"), 0)],
)
def test_a_network_addresses_as_many_members_as_it_has_outputs_or_heads(network: StackedMLP, members: int) -> None:
    assert addressed_members(network) == members


def test_a_model_may_be_addressed_by_heads_on_a_trunk() -> None:
    world = drive()
    plain = untrained_model(world)
    heads = StackedMLP(3, (5, 16, 8, 1), "tanh", torch.Generator().manual_seed(0), shared=1).requires_grad_(False)
    for weights in heads.weights:
        weights *= 4.0  # so that each member is the best somewhere
    model = AddressedDynamics(plain.features, plain.ensemble, heads)
    observation, action = torch.from_numpy(world.observation), torch.from_numpy(world.action)
    chosen = addressing_scores(heads, model.features.encode(observation, action)).argmax(dim=1)
    assert set(chosen.tolist()) == {0, 1, 2}
    assert torch.equal(model.address(observation, action), chosen)
    torch.testing.assert_close(
        StepModule(model)(observation, action), model.predict(observation, action), rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize("addressing", [StackedMLP(2, (5, 4, 1), "relu"), StackedMLP(3, (5, 4, 2), "relu")])
def test_heads_that_do_not_fit_the_members_are_refused(addressing: StackedMLP) -> None:
    plain = untrained_model(drive())
    with pytest.raises(ModelError, match=r"one network with 5 inputs and 3 outputs, or 3 heads of one output"):
        AddressedDynamics(plain.features, plain.ensemble, addressing)


@pytest.mark.parametrize("addressing", [PLAIN, HEADS])
def test_a_step_costs_the_addressing_network_and_what_its_mode_evaluates(addressing: StackedMLP) -> None:
    members, whole = StackedMLP(3, (5, 7, 2), "relu"), addressing.multiply_adds()
    one = 5 * 7 + 7 * 2
    expected: dict[Use, int] = {
        "argmax": whole + one,
        "sample": whole + one,
        "mixture": whole + 3 * one + 3 * 2,
        "blend": whole + 3 * one + 3 * (7 + 2),
    }
    assert {mode: multiply_adds_a_step(members, addressing, mode) for mode in expected} == expected


def test_without_addressing_a_step_costs_one_network_or_the_mixture_of_all_by_phase() -> None:
    single, points = StackedMLP(1, (5, 7, 2), "relu"), StackedMLP(4, (5, 7, 2), "relu")
    assert multiply_adds_a_step(single, None, "argmax") == 5 * 7 + 7 * 2
    assert multiply_adds_a_step(points, None, "phase") == 4 * (5 * 7 + 7 * 2) + 4 * (7 + 2)


def test_the_cost_of_a_mode_that_there_is_not_is_refused() -> None:
    with pytest.raises(ModelError, match="no addressing mode 'median'"):
        multiply_adds_a_step(PLAIN, None, "median")  # type: ignore[arg-type] # that is the point
