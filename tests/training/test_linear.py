from itertools import islice
from pathlib import Path

import numpy as np
import torch
from learning import ADDRESSING, ENSEMBLE, car_samples, swing

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.networks.ridge import Ridge, fit_ridge, linear_maps
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.portable import StepModule
from addressed_dynamics.sources.transitions.params import FeatureParams
from addressed_dynamics.training.baselines import total_parameters
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import HOLDING, train_ensemble, untrained_ensemble

FEATURES, TRAIN, VALIDATION = car_samples()
STILL = ENSEMBLE.optimiser.model_copy(update={"learning_rate": 1e-30})
LINEAR = ENSEMBLE.model_copy(update={"linear": True})


def test_every_member_begins_with_the_least_squares_solution_beside_its_layers() -> None:
    params = LINEAR.model_copy(update={"optimiser": STILL, "epochs": 1, "cluster_epochs": 1})
    network = next(train_ensemble(TRAIN, VALIDATION, params, seed=3, loss_unit=1.0)).network
    layers = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], ENSEMBLE, seed=3)
    x = np.hstack([TRAIN.x.numpy(), np.ones((len(TRAIN), 1))])
    solution, *_ = np.linalg.lstsq(x.astype(np.float64), TRAIN.y.numpy().astype(np.float64))
    expected = torch.from_numpy(x @ solution).float()
    for member in range(2):
        found = network(TRAIN.x)[member] - layers(TRAIN.x)[member]
        torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-3)


def test_a_linear_part_is_trained_along_and_goes_on_bit_for_bit(tmp_path: Path) -> None:
    *_, straight = train_ensemble(TRAIN, VALIDATION, LINEAR, seed=3, loss_unit=1.0)
    assert not torch.equal(straight.network.linear[0][0], straight.network.linear[0][1])
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    for _ in islice(train_ensemble(TRAIN, VALIDATION, LINEAR, seed=3, loss_unit=1.0, checkpoint=checkpoint), 3):
        pass
    *_, resumed = train_ensemble(TRAIN, VALIDATION, LINEAR, seed=3, loss_unit=1.0, checkpoint=checkpoint)
    for found, expected in zip(resumed.network.parameters(), straight.network.parameters(), strict=True):
        assert torch.equal(found, expected)


def test_the_portable_model_has_the_linear_part() -> None:
    *_, last = train_ensemble(TRAIN, VALIDATION, LINEAR, seed=3, loss_unit=1.0)
    addressing = StackedMLP(1, (FEATURES.inputs, 8, 2), "relu", torch.Generator().manual_seed(0))
    model = AddressedDynamics(FEATURES, last.network.requires_grad_(False), addressing.requires_grad_(False))
    states, action = torch.tensor([[-0.5, 0.01], [0.3, -0.02], [-1.1, 0.0]]), torch.tensor([0, 2, 1])
    torch.testing.assert_close(StepModule(model)(states, action), model.predict(states, action))
    without = StackedMLP(2, last.network.widths, last.network.activation)
    without.load_state_dict({name: each for name, each in last.network.state_dict().items() if "linear" not in name})
    assert not torch.allclose(
        AddressedDynamics(FEATURES, without, addressing).predict(states, action), model.predict(states, action)
    )


def test_one_network_of_as_many_parameters_counts_the_linear_parts() -> None:
    wide = LINEAR.model_copy(update={"members": 3, "hidden": (16,)})
    addressing = ADDRESSING.model_copy(update={"hidden": (8,)})
    found = total_parameters(wide, addressing, 20, 4, 200)
    one, members = (StackedMLP(each.members, (20, *each.hidden, 4), "relu", linear=True) for each in (found, wide))
    assert found.linear
    picks = (20 + 1) * 8 + (8 + 1) * 3
    assert abs(one.parameters_total - members.parameters_total - picks) <= 20 + 1 + 4


def test_with_a_horizon_they_begin_with_the_best_map_of_those_that_hold_for_many_steps() -> None:
    # Nothing but noise, and few samples of it: a map that is shrunk more builds less on what it said before.
    parts = [swing((30,), seed=6), swing((14,), seed=56)]
    features = fit_features(parts[0], FeatureParams(target="change", history=4))
    train, validation = (features.samples(each, courses=True) for each in parts)
    errors = {each.penalty: rolled_out(each, features, parts[1]) for each in linear_maps(train.x, train.y)}
    holding = [penalty for penalty, error in errors.items() if error <= HOLDING * min(errors.values())]
    assert fit_ridge((train.x, train.y), (validation.x, validation.y)).penalty not in holding
    expected = fit_ridge((train.x, train.y), (validation.x, validation.y), holding).weight
    still = {"optimiser": STILL, "epochs": 1, "cluster_epochs": 1, "horizon": 3, "loss": "mse"}
    network = next(train_ensemble(train, validation, LINEAR.model_copy(update=still), seed=3, loss_unit=1.0)).network
    for member in range(2):
        torch.testing.assert_close(network.linear[0][member], expected)


def rolled_out(ridge: Ridge, features: FeatureSpec, world: Transitions) -> float:
    """The mean squared error of states, from each start to the end of the one episode: of its steps, then of starts."""
    stack = StackedMLP(1, tuple(ridge.weight.shape), "relu").requires_grad_(False)
    stack.weights[0].copy_(ridge.weight.unsqueeze(0))
    stack.biases[0].copy_(ridge.bias.view(1, 1, -1))
    model, frames, scale = AddressedDynamics(features, stack), features.history, np.array(features.scale)
    errors = []
    for start in range(len(world) - frames + 1):
        predicted = model.rollout(world.observation[None, start : start + frames], world.action[None, start:])[0]
        errors.append(np.square((predicted - world.next_observation[start + frames - 1 :]) / scale).mean())
    return float(np.mean(errors))
