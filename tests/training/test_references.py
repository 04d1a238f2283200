"""References in closed form: nothing changes, and linear least squares, as models like any other."""

import numpy as np
import pytest
import torch
from learning import drive, sail, swing

from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.transitions.spec import FeatureSpec, fit_features
from addressed_dynamics.features.transitions.windows import window_rows
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import FeatureParams
from addressed_dynamics.training.references import reference_costs, reference_networks


def references(
    world: Transitions, *, target: str = "change", history: int = 1, history_weight: float = 1.0
) -> dict[str, AddressedDynamics]:
    params = {"target": target, "history": history, "history_weight": history_weight}
    features = fit_features(world, FeatureParams.model_validate(params))
    samples = features.samples(world)
    data: TrainingData[FeatureSpec] = TrainingData(
        features,
        samples,
        samples,
        persistence=features.persistence,
        last_change=features.last_change,
        last_frame=features.frame_inputs if history > 1 else None,
    )
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


@pytest.mark.parametrize("target", ["change", "absolute"])
@pytest.mark.parametrize("history", [2, 3])
@pytest.mark.parametrize("history_weight", [1.0, 0.1])
def test_the_last_change_goes_on(target: str, history: int, history_weight: float) -> None:
    world = swing((30, 20))
    model = references(world, target=target, history=history, history_weight=history_weight)["last_change"]
    frames = np.arange(5, 9)[:, None] + np.arange(1 - history, 1)
    predicted = model.predict(world.observation[frames], world.action[frames])
    now, before = world.observation[frames[:, -1]], world.observation[frames[:, -2]]
    np.testing.assert_allclose(predicted, 2 * now - before, atol=1e-5)


def test_the_last_change_rolls_out_in_a_straight_line_at_constant_velocity() -> None:
    model = references(swing((30, 20)), history=2)["last_change"]
    course = np.linspace([0.0, -1.0], [1.5, 2.0], 16, dtype=np.float32)
    found = model.rollout(course[None, :2], np.zeros((1, 15, 2), np.float32))
    np.testing.assert_allclose(found[0], course[2:], atol=1e-4)


def test_one_frame_has_no_last_change_and_no_other_linear_map() -> None:
    assert list(references(swing((30, 20)))) == ["persistence", "linear"]
    assert list(references(swing((30, 20)), history=2)) == ["persistence", "last_change", "linear", "linear_frame"]


def test_the_linear_map_of_the_last_frame_is_that_of_least_squares_on_it_alone() -> None:
    world = drive((60, 60))
    model = references(world, history=3)["linear_frame"]
    assert not bool(model.ensemble.weights[0][0, : 2 * model.features.frame_inputs].any())
    frames = window_rows(world, 3)[:, None] + np.arange(-2, 1)
    rows = frames[:, -1]
    known = np.column_stack([world.observation[rows], np.eye(3)[world.action[rows]][:, :2], np.ones(len(rows))])
    weights = np.linalg.lstsq(known, world.next_observation[rows].astype(np.float64), rcond=None)[0]
    found = model.predict(world.observation[frames], world.action[frames])
    np.testing.assert_allclose(found, known @ weights, atol=2e-5)


@pytest.mark.parametrize(
    ("name", "costs"),
    [("persistence", (0, 0)), ("last_change", (0, 0)), ("linear", (26, 24)), ("linear_frame", (10, 8))],
)
def test_references_cost_what_they_compute_with(name: str, costs: tuple[int, int]) -> None:
    assert reference_costs(name, 12, 2, 4) == costs


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
