"""References in closed form: nothing changes, and linear least squares, as models like any other."""

import numpy as np
import pytest
import torch
from learning import drive, sail, swing

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import FeatureParams
from addressed_dynamics.training.references import reference_networks


def references(world: Transitions, *, target: str = "change", history: int = 1) -> dict[str, AddressedDynamics]:
    features = fit_features(world, FeatureParams.model_validate({"target": target, "history": history}))
    samples = features.samples(world)
    data: TrainingData[FeatureSpec] = TrainingData(features, samples, samples, persistence=features.persistence)
    found: dict[str, StackedMLP] = dict(reference_networks(data))
    return {name: AddressedDynamics(features, network, None) for name, network in found.items()}


@pytest.mark.parametrize("target", ["change", "absolute"])
@pytest.mark.parametrize("history", [1, 3])
def test_persistence_is_the_state_itself(target: str, history: int) -> None:
    world = swing((30, 20))
    model = references(world, target=target, history=history)["persistence"]
    rows = np.arange(5, 9)
    frames = rows[:, None] + np.arange(1 - history, 1)
    given = frames if history > 1 else rows
    predicted = model.predict(world.observation[given], world.action[given])
    np.testing.assert_allclose(predicted, world.observation[rows], atol=1e-5)


def test_a_linear_world_is_known_to_the_linear_map() -> None:
    world = sail((60, 60))
    model = references(world)["linear"]
    predicted = model.predict(world.observation, world.action, exogenous=world.exogenous)
    np.testing.assert_allclose(predicted, world.next_observation, atol=1e-4)


def test_the_linear_map_is_that_of_least_squares() -> None:
    world = drive((60, 60))
    model = references(world)["linear"]
    one_hot = np.eye(3)[world.action][:, :2]
    known = np.column_stack([world.observation, one_hot, np.ones(len(world))]).astype(np.float64)
    weights = np.linalg.lstsq(known, world.next_observation.astype(np.float64), rcond=None)[0]
    found = model.predict(world.observation, world.action)
    np.testing.assert_allclose(found, known @ weights, atol=2e-5)


def test_without_validation_samples_the_smallest_penalty_is_taken() -> None:
    world = sail((60, 60))
    features = fit_features(world, FeatureParams())
    empty = features.samples(world.select(np.zeros(len(world), dtype=np.bool_)))
    data = TrainingData(features, features.samples(world), empty, persistence=features.persistence)
    linear = dict(reference_networks(data))["linear"]
    samples = features.samples(world)
    assert isinstance(samples.x, torch.Tensor)
    with torch.no_grad():
        assert float((linear(samples.x)[0] - samples.y).square().mean()) < 1e-8


def test_a_kind_with_references_of_its_own_has_none_of_these() -> None:
    features = fit_features(sail(), FeatureParams())
    samples = features.samples(sail())
    assert dict(reference_networks(TrainingData(features, samples, samples))) == {}
