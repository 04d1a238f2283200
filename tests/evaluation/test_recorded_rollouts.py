"""Rollouts beside recorded episodes: which stretches are taken, and what a model is held against."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from builders import car_transitions
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import drive, swing, untrained_model
from strategies import random_transitions, space_specs, transitions

from addressed_dynamics.errors import EvaluationError
from addressed_dynamics.evaluation.candidates import Candidate
from addressed_dynamics.evaluation.rollouts import rollout_errors, summarise_rollouts
from addressed_dynamics.evaluation.suite import evaluate_rollouts, figure_arrays
from addressed_dynamics.evaluation.truth import TrueRollouts, replay_recorded, true_rollouts
from addressed_dynamics.params import EnvironmentParams, EnvironmentRollouts, RecordedRollouts
from addressed_dynamics.transitions import COLUMNS, SpaceSpec, Transitions


def replay(test: Transitions, episodes: int = 5, steps: int = 10, seed: int = 0) -> TrueRollouts:
    return replay_recorded(RecordedRollouts(kind="recorded", episodes=episodes, steps=steps, seed=seed), test)


def moderate(spec: SpaceSpec, lengths: list[int], seed: int) -> Transitions:
    """Episodes of random numbers up to 1: a rollout of larger ones may reach a million, where it counts as diverged."""
    wild = random_transitions(spec, lengths, np.random.default_rng(seed))
    columns = {name: getattr(wild, name) for name in COLUMNS}
    numbers = {name: values.clip(-1.0, 1.0) for name, values in columns.items() if values.dtype == np.float32}
    return Transitions(spec=spec, **columns | numbers)


@dataclass
class Perfect:
    """A model that knows the future."""

    truth: TrueRollouts

    def rollout(self, observation: np.ndarray, actions: np.ndarray, _mode: str, **_: object) -> np.ndarray:
        np.testing.assert_array_equal(observation, self.truth.states[:, 0])
        np.testing.assert_array_equal(actions, self.truth.actions)
        return self.truth.states[:, 1:].astype(np.float32)


@given(transitions(max_length=12), st.integers(1, 8), st.integers(2, 8), st.integers(0, 2**31 - 1))
def test_every_stretch_is_a_piece_of_one_episode_and_none_overlaps_another(
    test: Transitions, episodes: int, steps: int, seed: int
) -> None:
    lengths = [rows.stop - rows.start for rows in test.episode_slices()]
    if max(lengths) < 2:
        with pytest.raises(EvaluationError, match="at least 2 are needed"):
            replay(test, episodes, steps, seed)
        return
    truth = replay(test, episodes, steps, seed)
    assert truth.steps == min(steps, max(lengths))
    number = min(episodes, sum(length // truth.steps for length in lengths))
    assert truth.states.shape == (number, truth.steps + 1, len(test.spec.observation))
    assert truth.actions.shape == (number, truth.steps, *test.action.shape[1:])
    assert truth.actions.dtype == test.action.dtype
    assert list(truth.groups) == ["all"]
    after = 0
    for states, actions in zip(truth.states, truth.actions, strict=True):
        start = next(
            row
            for row in range(after, len(test))
            if (states[:-1] == test.observation[row : row + truth.steps]).all()
            and (actions == test.action[row : row + truth.steps]).all()
        )
        after = start + truth.steps
        assert len(set(test.episode[start:after])) == 1
        np.testing.assert_array_equal(states[1:], test.next_observation[start:after])


def test_the_same_seed_takes_the_same_stretches_and_another_takes_others() -> None:
    test = car_transitions([100, 80, 95])
    np.testing.assert_array_equal(replay(test, seed=3).states, replay(test, seed=3).states)
    assert (replay(test, seed=3).states != replay(test, seed=4).states).any()


def test_all_stretches_are_taken_in_order_where_there_are_no_more_than_asked_for() -> None:
    test = car_transitions([25, 9, 10])
    truth = replay(test, episodes=100, steps=10)
    np.testing.assert_array_equal(truth.states[:, 0], test.observation[[0, 10, 34]])


def test_stretches_are_as_long_as_the_longest_episode_where_none_is_as_long_as_asked_for() -> None:
    truth = replay(car_transitions([7, 9, 4]), steps=1000)
    assert truth.states.shape == (1, 10, 2)


@pytest.mark.parametrize("lengths", [[], [1, 1, 1]])
def test_episodes_of_one_step_cannot_be_rolled_out(lengths: list[int]) -> None:
    whole = car_transitions([1, 1, 1])
    test = Transitions(spec=whole.spec, **{name: getattr(whole, name)[: len(lengths)] for name in COLUMNS})
    with pytest.raises(EvaluationError, match=f"of the {len(lengths)} has {int(bool(lengths))} steps") as caught:
        replay(test)
    assert "\n" not in str(caught.value)


@settings(max_examples=30)
@given(space_specs(max_size=6), st.integers(0, 2**31 - 1))
def test_a_perfect_model_has_no_error_whatever_the_spaces(spec: SpaceSpec, seed: int) -> None:
    truth = replay(moderate(spec, [12, 30], seed))
    squared, predicted = rollout_errors(Perfect(truth), truth, "argmax")  # type: ignore[arg-type] # all that is used
    summary = summarise_rollouts(squared, predicted, truth, spec.observation)
    assert {name for name in summary if name != "left_bounds_share"} == {"all"}
    assert summary["all"]["episodes"] == 4
    assert all(spread["max"] == 0.0 for spread in summary["all"]["mse"].values())


@settings(max_examples=30)
@given(space_specs(max_size=6), st.integers(0, 2**31 - 1))
def test_a_model_is_rolled_out_under_the_recorded_actions_whatever_the_spaces(spec: SpaceSpec, seed: int) -> None:
    world = moderate(spec, [40, 30], seed)
    model, truth = untrained_model(world), replay(world, steps=12)
    squared, predicted = rollout_errors(model, truth, "argmax")
    state = truth.states[:, 0].astype(np.float32)
    for step in range(truth.steps):
        state = model.predict(state, truth.actions[:, step])
        np.testing.assert_array_equal(predicted[:, step], state)
        np.testing.assert_allclose(squared[:, step], (state.astype(float) - truth.states[:, step + 1]) ** 2)


@pytest.mark.parametrize(("steps", "horizons"), [(2, [1, 2]), (50, range(2, 51, 2)), (300, range(10, 301, 10))])
def test_short_rollouts_have_a_table_of_errors_against_the_horizon_too(steps: int, horizons: list[int]) -> None:
    world = swing((300, 310))
    model = untrained_model(world)
    candidate = Candidate("ensemble/argmax", "ensemble", 1, model.predict, model, "argmax")
    _, rows = evaluate_rollouts(candidate, replay(world, steps=steps))
    assert [row["horizon"] for row in rows] == list(horizons)
    assert all(left["horizon"] < right["horizon"] for left, right in pairwise(rows))


def test_one_stretch_in_the_middle_stands_for_all_in_the_figures() -> None:
    world = swing((40, 30))
    model, truth = untrained_model(world), replay(world, steps=12)
    arrays = figure_arrays(model, model.ensemble, world, truth, "mse")
    assert arrays["rollout_group"].tolist() == ["all"]
    np.testing.assert_array_equal(arrays["rollout_true"], truth.states[[len(truth.states) // 2]])
    assert arrays["rollout_predicted"].shape == arrays["rollout_true"].shape


def test_a_params_file_says_where_rollouts_come_from() -> None:
    test = drive((40, 30))
    recorded = RecordedRollouts(kind="recorded", episodes=2, steps=10, seed=0)
    np.testing.assert_array_equal(true_rollouts(recorded, test).states, replay_recorded(recorded, test).states)
    environment = EnvironmentParams(id="addressed_dynamics/MountainCarContinuing-v0", kwargs={})
    driven = EnvironmentRollouts(
        kind="environment", environment=environment, episodes=3, steps=10, seed=0, swing_share=0.5, mean_hold_steps=2
    )
    assert list(true_rollouts(driven, test).groups) == ["all", "no_wall", "wall"]
