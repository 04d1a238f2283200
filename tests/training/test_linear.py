from itertools import islice
from pathlib import Path

import numpy as np
import torch
from learning import ADDRESSING, ENSEMBLE, car_samples

from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.portable import PortableDynamics
from addressed_dynamics.training.baselines import total_parameters
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import train_ensemble, untrained_ensemble

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
    given = torch.cat([states, action.unsqueeze(1)], dim=1)
    torch.testing.assert_close(PortableDynamics(model)(given), model.predict(states, action))
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
