import numpy as np
import pytest
import torch
from builders import car_transitions
from learning import CHANGE

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import Mode
from addressed_dynamics.simulators.portable import StepModule

PENDULUM = SpaceSpec(
    observation=tuple(Dimension(f"angle_{i}", "rad", -1.0, 1.0) for i in range(3)),
    action=ContinuousAction((Dimension("torque", "Nm", -1.0, 1.0), Dimension("wind", "", -1.0, 1.0))),
    step_seconds=0.02,
)


def random_model(features: FeatureSpec, members: int) -> AddressedDynamics:
    generator = torch.Generator().manual_seed(0)
    ensemble = StackedMLP(members, (features.inputs, 16, features.outputs), "relu", generator)
    addressing = StackedMLP(1, (features.inputs, 16, members), "relu", generator) if members > 1 else None
    return AddressedDynamics(features, ensemble, addressing)


def pendulum_features() -> FeatureSpec:
    return FeatureSpec(
        PENDULUM, 1, 1.0, "absolute", (), "atan2", "predicted", (0.1,) * 5, (2.0,) * 5, (2.0,) * 3, (0.2,) * 3, 0.7
    )


@pytest.mark.parametrize("members", [1, 2, 5])
def test_it_predicts_what_the_model_does_from_discrete_actions(members: int) -> None:
    transitions = car_transitions([40, 30])
    model = random_model(fit_features(transitions, CHANGE), members)
    with torch.no_grad():
        found = StepModule(model)(torch.from_numpy(transitions.observation), torch.from_numpy(transitions.action))
    np.testing.assert_allclose(found, model.predict(transitions.observation, transitions.action), rtol=1e-5, atol=1e-6)


def test_it_predicts_what_the_model_does_from_continuous_actions() -> None:
    model = random_model(pendulum_features(), 4)
    inputs = np.random.default_rng(0).normal(size=(50, 5)).astype(np.float32)
    with torch.no_grad():
        found = StepModule(model)(*torch.from_numpy(inputs).split([3, 2], dim=1))
    np.testing.assert_allclose(found, model.predict(inputs[:, :3], inputs[:, 3:]), rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("mode", ["argmax", "mixture", "blend"])
def test_it_addresses_in_the_model_s_own_mode(mode: Mode) -> None:
    model = random_model(pendulum_features(), 3)
    model.mode = mode
    inputs = np.random.default_rng(0).normal(size=(50, 5)).astype(np.float32)
    with torch.no_grad():
        found = StepModule(model)(*torch.from_numpy(inputs).split([3, 2], dim=1))
    np.testing.assert_allclose(found, model.predict(inputs[:, :3], inputs[:, 3:], mode), rtol=1e-5, atol=1e-5)


def test_a_model_that_draws_its_members_is_refused() -> None:
    model = random_model(pendulum_features(), 3)
    model.mode = "sample"
    with pytest.raises(ModelError, match="take another mode"):
        StepModule(model)
