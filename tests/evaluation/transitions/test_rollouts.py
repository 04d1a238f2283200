from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import torch
from builders import CAR, car_transitions
from learning import drive, untrained_model
from rollout_errors import rollout_errors

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.envs.mountain_car import mountain_car_step
from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.transitions.rollouts import flown_off_share, seen_range, summarise_rollouts
from addressed_dynamics.evaluation.transitions.spreads import against_horizon
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, record_true_rollouts
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts

CONTINUING = "addressed_dynamics/MountainCarContinuing-v0"
PARAMS = EnvironmentRollouts(
    kind="environment",
    environment=EnvironmentParams(id=CONTINUING, kwargs={}),
    episodes=12,
    steps=150,
    seed=7,
    swing_share=0.8,
    mean_hold_steps=5,
)
CAR_DIMENSIONS = CAR.observation


@lru_cache
def truth() -> TrueRollouts:
    return record_true_rollouts(PARAMS, CAR_DIMENSIONS, 1)


@dataclass
class Scripted:
    """A model whose rollouts are given: `predicted` (episode, step, observation)."""

    predicted: np.ndarray

    def rollout(self, observation: np.ndarray, actions: np.ndarray, _mode: str, **_: object) -> np.ndarray:
        np.testing.assert_array_equal(observation, truth().states[:, 0])
        np.testing.assert_array_equal(actions, truth().actions)
        return self.predicted


def errors(predicted: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return rollout_errors(Scripted(predicted), truth(), "argmax")  # type: ignore[arg-type] # all that is used of a model


def test_a_perfect_model_has_no_error_and_never_leaves_the_bounds() -> None:
    squared, predicted = errors(truth().states[:, 1:].astype(np.float32))
    summary = summarise_rollouts(squared, predicted, truth(), CAR_DIMENSIONS)
    assert summary["left_bounds_share"] == 0.0
    assert summary["groups"]["all"]["mse"]["position"]["max"] == 0.0
    assert summary["groups"]["all"]["mse"]["velocity"]["max"] == 0.0


def test_sampled_rollouts_are_the_same_whatever_was_drawn_before() -> None:
    model = untrained_model(drive((20, 20)))
    first, _ = rollout_errors(model, truth(), "sample")
    torch.rand(3)
    np.testing.assert_array_equal(rollout_errors(model, truth(), "sample")[0], first)


def test_true_rollouts_follow_the_physics_from_state_to_state() -> None:
    states, actions = truth().states, truth().actions
    after = mountain_car_step(states[:, :-1].reshape(-1, 2), actions.reshape(-1))
    np.testing.assert_allclose(after, states[:, 1:].reshape(-1, 2), atol=2e-7)  # the environment shows float32


def test_true_rollouts_are_the_same_for_the_same_seed_and_others_for_another() -> None:
    again = record_true_rollouts(PARAMS, CAR_DIMENSIONS, 1)
    other = record_true_rollouts(PARAMS.model_copy(update={"seed": 8}), CAR_DIMENSIONS, 1)
    np.testing.assert_array_equal(again.states, truth().states)
    assert (other.actions != truth().actions).any()


def test_episodes_that_touch_a_wall_are_told_from_those_that_do_not() -> None:
    touched = [bool(((p <= np.float32(-1.2)) | (p >= np.float32(0.6))).any()) for p in truth().states[:, 1:, 0]]
    assert truth().groups["wall"].tolist() == touched
    assert truth().groups["no_wall"].tolist() == [not each for each in touched]
    assert truth().groups["all"].all()
    assert len(set(touched)) == 2


def test_the_first_steps_of_an_environment_are_the_history_of_a_model() -> None:
    steps = PARAMS.model_copy(update={"steps": 147})
    found = record_true_rollouts(steps, CAR_DIMENSIONS, 4)
    np.testing.assert_array_equal(found.history_states, truth().states[:, :4])
    np.testing.assert_array_equal(found.history_actions, truth().actions[:, :3])
    np.testing.assert_array_equal(found.states, truth().states[:, 3:])
    np.testing.assert_array_equal(found.actions, truth().actions[:, 3:])


def test_errors_and_their_summary_equal_a_loop_over_the_episodes() -> None:
    generator = np.random.default_rng(0)
    predicted = (truth().states[:, 1:] + generator.normal(0, 0.01, truth().states[:, 1:].shape)).astype(np.float32)
    squared, returned = errors(predicted)
    np.testing.assert_array_equal(returned, predicted)
    summary = summarise_rollouts(squared, returned, truth(), CAR_DIMENSIONS)
    for group, members in {
        "all": range(12),
        "wall": np.flatnonzero(truth().groups["wall"]),
        "no_wall": np.flatnonzero(truth().groups["no_wall"]),
    }.items():
        assert summary["groups"][group]["episodes"] == len(members)
        for index, name in enumerate(("position", "velocity")):
            per_episode = [
                np.mean(
                    [(predicted[e, t, index].astype(float) - truth().states[e, t + 1, index]) ** 2 for t in range(150)]
                )
                for e in members
            ]
            found = summary["groups"][group]["mse"][name]
            assert found["median"] == pytest.approx(np.median(per_episode))
            assert found["mean"] == pytest.approx(np.mean(per_episode))
            assert found["max"] == pytest.approx(max(per_episode))


@pytest.mark.parametrize(("beyond", "share"), [(0.0, 0.0), (0.017, 0.0), (0.019, 0.25), (5.0, 0.25)])
def test_a_rollout_has_left_the_bounds_when_it_is_outside_by_more_than_a_hundredth_of_their_range(
    beyond: float, share: float
) -> None:
    predicted = truth().states[:, 1:].clip([-1.1, -0.06], [0.5, 0.06])
    predicted[:2, 40, 0] = 0.6 + beyond
    predicted[2, 90, 0] = -1.2 - beyond
    summary = summarise_rollouts(*errors(predicted), truth(), CAR_DIMENSIONS)
    assert summary["left_bounds_share"] == share


def test_a_dimension_without_bounds_cannot_be_left() -> None:
    unbounded = tuple(replace(dimension, low=-np.inf, high=np.inf) for dimension in CAR_DIMENSIONS)
    far = np.full_like(truth().states[:, 1:], 1e3)
    assert summarise_rollouts(*errors(far), truth(), unbounded)["left_bounds_share"] is None
    in_part = (CAR_DIMENSIONS[0], unbounded[1])
    far[..., 0] = truth().states[:, 1:, 0]
    assert summarise_rollouts(*errors(far), truth(), in_part)["left_bounds_share"] == 0.0


@pytest.mark.parametrize(("value", "share"), [(0.59, 0.0), (0.61, 0.25), (-0.61, 0.25), (np.nan, 0.25), (np.inf, 0.25)])
def test_a_rollout_flies_off_when_it_is_outside_of_what_was_trained_on_by_more_than_its_width(
    value: float, share: float
) -> None:
    train = car_transitions([40, 30])
    low, high = seen_range(train)
    states = np.concatenate([train.observation, train.next_observation])
    np.testing.assert_array_equal([low, high], [states.min(axis=0), states.max(axis=0)])
    seen = np.array([[-0.2, 3.0], [0.2, 3.0]])  # the second dimension never changed
    predicted = np.tile(np.array([0.1, 3.9], np.float32), (4, 5, 1))
    predicted[2, 3, 0] = value
    assert flown_off_share(predicted, seen) == share
    predicted[:, 1, 1] = 4.1
    assert flown_off_share(predicted, seen) == 1.0


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_a_rollout_that_diverges_counts_as_a_large_finite_error(value: float) -> None:
    predicted = truth().states[:, 1:].copy()
    predicted[3, 20:] = value
    squared, returned = errors(predicted)
    assert np.isfinite(squared).all()
    assert squared[3, 20:].min() > 1e11
    assert summarise_rollouts(squared, returned, truth(), CAR_DIMENSIONS)["left_bounds_share"] == 1 / 12


def test_the_error_at_a_horizon_is_that_of_the_state_after_so_many_steps() -> None:
    values = {name: np.random.default_rng(index).random((12, 150)) for index, name in enumerate(("push", "pull"))}
    assert all(row["push_p10"] is row["push_p90"] is None for row in against_horizon(values, truth()))
    values, many = {name: np.tile(each, (7, 1)) for name, each in values.items()}, truth().select([*range(12)] * 7)
    assert min(int(members.sum()) for members in many.groups.values()) >= 20
    rows = against_horizon(values, many)
    assert [(row["group"], row["horizon"]) for row in rows] == [
        (group, horizon) for group in ("all", "no_wall", "wall") for horizon in range(7, 151, 7)
    ]
    for row in rows:
        at = {name: each[many.groups[row["group"]], row["horizon"] - 1] for name, each in values.items()}
        assert row["push_p50"] == pytest.approx(np.median(at["push"]), rel=1e-4)
        assert row["pull_p90"] == pytest.approx(np.quantile(at["pull"], 0.9), rel=1e-4)
        assert row["pull_p10"] == pytest.approx(np.quantile(at["pull"], 0.1), rel=1e-4)


def test_a_group_without_episodes_has_no_place_in_the_table() -> None:
    nobody = np.zeros(12, dtype=bool)
    rows = against_horizon({"push": np.ones((12, 150))}, replace(truth(), groups={"all": ~nobody, "wall": nobody}))
    assert {row["group"] for row in rows} == {"all"}


def test_the_rollouts_of_a_model_are_compared_with_the_states_after_each_action() -> None:
    model = untrained_model(drive())
    squared, predicted = rollout_errors(model, truth(), "argmax")
    state = truth().states[:, 0].astype(np.float32)
    for step in range(3):
        state = model.predict(state, truth().actions[:, step])
        np.testing.assert_array_equal(predicted[:, step], state.clip(-1e6, 1e6))
        np.testing.assert_allclose(squared[:, step], (state.astype(float) - truth().states[:, step + 1]) ** 2)


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ({"id": "NoSuchCar-v0", "kwargs": {}}, "cannot be made"),
        ({"id": CONTINUING, "kwargs": {"wheels": 4}}, "cannot be made"),
        ({"id": "MountainCarContinuous-v0", "kwargs": {}}, "need discrete actions"),
        ({"id": "CartPole-v1", "kwargs": {}}, "use a variant that goes on"),
    ],
)
def test_environments_that_cannot_be_rolled_out_are_refused(environment: dict[str, Any], message: str) -> None:
    params = PARAMS.model_copy(update={"environment": EnvironmentParams(**environment)})
    dimensions = tuple(Dimension(f"observation_{i}", "", -1.0, 1.0) for i in range(4))
    wanted = dimensions if "CartPole" in params.environment.id else CAR_DIMENSIONS
    with pytest.raises(EvaluationError, match=message) as caught:
        record_true_rollouts(params, wanted, 1)
    assert "\n" not in str(caught.value)
