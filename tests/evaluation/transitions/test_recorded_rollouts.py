"""Rollouts beside recorded episodes: which stretches are taken, and what a model is held against."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
import torch
from builders import CAR, car_transitions
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import drive, swing, untrained_model
from rollout_errors import rollout_errors
from strategies import random_transitions, space_specs, transitions

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.episodes.transitions import COLUMNS, SpaceSpec, Transitions
from addressed_dynamics.evaluation.transitions.candidates import MEAN, Candidate, ensemble_candidates, predictor_of
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.rollouts import evaluate_rollouts, free_run, roll_out, summarise_rollouts
from addressed_dynamics.evaluation.transitions.suite import figure_arrays
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, replay_recorded, true_rollouts
from addressed_dynamics.features.common.samples import Dropped
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts


def replay(
    test: Transitions,
    episodes: int = 5,
    steps: int = 10,
    seed: int = 0,
    history: int = 1,
    segments: Sequence[str] = ("alone",),
) -> TrueRollouts:
    """Replay episodes; their segments take turns."""
    params = RecordedRollouts(kind="recorded", episodes=episodes, steps=steps, seed=seed)
    numbers = dict.fromkeys(test.episode.tolist())
    named = {number: segments[index % len(segments)] for index, number in enumerate(numbers)}
    return replay_recorded(params, test, history, named)


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
        history = self.truth.history_states.shape[1]
        if history == 1:
            np.testing.assert_array_equal(observation, self.truth.states[:, 0])
            np.testing.assert_array_equal(actions, self.truth.actions)
        else:
            np.testing.assert_array_equal(observation, self.truth.history_states)
            np.testing.assert_array_equal(actions[:, : history - 1], self.truth.history_actions)
            np.testing.assert_array_equal(actions[:, history - 1 :], self.truth.actions)
        return self.truth.states[:, 1:].astype(np.float32)


@given(transitions(max_length=12), st.integers(1, 8), st.integers(2, 8), st.integers(0, 2**31 - 1), st.integers(1, 4))
def test_every_stretch_is_a_piece_of_one_episode_and_overlaps_another_only_where_there_are_few(
    test: Transitions, episodes: int, steps: int, seed: int, history: int
) -> None:
    lengths = [rows.stop - rows.start - history + 1 for rows in test.episode_slices()]
    if max(lengths) < 2:
        with pytest.raises(EvaluationError, match=f"at least {history + 1} are needed"):
            replay(test, episodes, steps, seed, history)
        return
    truth = replay(test, episodes, steps, seed, history)
    assert truth.steps == min(steps, max(lengths))
    room = [max(length - truth.steps + 1, 0) for length in lengths]
    apart = sum(max(length, 0) // truth.steps for length in lengths)
    number = min(episodes, max(apart, min(episodes, sum(room))))
    assert truth.states.shape == (number, truth.steps + 1, len(test.spec.observation))
    assert truth.actions.shape == (number, truth.steps, *test.action.shape[1:])
    assert truth.actions.dtype == test.action.dtype
    assert list(truth.groups) == ["all"]
    after = 0
    for states, actions, before, earlier in zip(
        truth.states, truth.actions, truth.history_states, truth.history_actions, strict=True
    ):
        start = next(
            row
            for row in range(after, len(test))
            if (states[:-1] == test.observation[row : row + truth.steps]).all()
            and (actions == test.action[row : row + truth.steps]).all()
            and row + 1 >= history
            and (before == test.observation[row + 1 - history : row + 1]).all()
            and (earlier == test.action[row + 1 - history : row]).all()
        )
        after = start + 1 if truth.overlapping else start + truth.steps
        assert len(set(test.episode[start + 1 - history : start + truth.steps])) == 1
        np.testing.assert_array_equal(states[1:], test.next_observation[start : start + truth.steps])
    assert not truth.overlapping or apart < min(episodes, 20)


def test_the_same_seed_takes_the_same_stretches_and_another_takes_others() -> None:
    test = car_transitions([100, 80, 95])
    np.testing.assert_array_equal(replay(test, seed=3).states, replay(test, seed=3).states)
    assert (replay(test, seed=3).states != replay(test, seed=4).states).any()


def test_every_stretch_knows_its_episode_also_of_some_of_them() -> None:
    test = random_transitions(CAR, [25, 4, 12], np.random.default_rng(0))
    truth, numbers = replay(test, episodes=3), list(dict.fromkeys(test.episode.tolist()))
    assert truth.episode.tolist() == [numbers[0], numbers[0], numbers[2]]
    assert truth.select([2, 0]).episode.tolist() == [numbers[2], numbers[0]]
    for states, episode in zip(truth.states, truth.episode, strict=True):
        assert (test.observation[test.episode == episode] == states[0]).all(axis=1).any()


def test_all_stretches_are_taken_in_order_where_there_are_no_more_than_asked_for() -> None:
    test = car_transitions([205, 9, 10])
    truth = replay(test, episodes=100, steps=10)
    np.testing.assert_array_equal(truth.states[:, 0], test.observation[[*range(0, 200, 10), 214]])
    assert not truth.overlapping


def test_where_fewer_than_twenty_stretches_are_apart_as_many_more_begin_in_each_episode_at_equal_distances() -> None:
    test = car_transitions([28, 9, 10, 14])
    truth = replay(test, episodes=100, steps=10)
    # 19, none, 1 and 5 rows in which a stretch can begin: with 14, 0, 1 and 5 of them there are twenty.
    first = np.rint(np.linspace(0, 18, 14)).astype(int)
    np.testing.assert_array_equal(truth.states[:, 0], test.observation[[*first, 37, *range(47, 52)]])
    assert truth.overlapping
    assert np.unique(truth.episode, return_counts=True)[1].tolist() == [14, 1, 5]
    groups = summarise_rollouts(np.ones((20, 10, 2)), truth.states[:, 1:], truth, test.spec.observation)["groups"]
    assert (groups["all"]["episodes"], groups["all"]["rollouts"]) == (3, 20)


def test_an_episode_with_many_stretches_keeps_them_where_others_begin_more_often() -> None:
    test = car_transitions([150, 30, 30])
    truth = replay(test, episodes=100, steps=10)
    starts = [*range(0, 150, 10), 150, 160, 170, 180, 190, 200]
    assert not truth.overlapping
    np.testing.assert_array_equal(truth.states[:, 0], test.observation[starts])
    truth = replay(car_transitions([150, 20, 20]), episodes=100, steps=10)
    assert np.unique(truth.episode, return_counts=True)[1].tolist() == [15, 3, 3]
    assert truth.overlapping


def test_no_more_stretches_begin_than_are_asked_for_and_all_do_where_those_are_few() -> None:
    assert len(replay(car_transitions([100]), episodes=7, steps=10).states) == 7
    assert not replay(car_transitions([100]), episodes=7, steps=10).overlapping
    few = replay(car_transitions([12, 11]), episodes=40, steps=10)
    np.testing.assert_array_equal(few.states[:, 0], car_transitions([12, 11]).observation[[0, 1, 2, 12, 13]])


def test_stretches_are_as_long_as_the_longest_episode_where_none_is_as_long_as_asked_for() -> None:
    truth = replay(car_transitions([7, 9, 4]), steps=1000)
    assert truth.states.shape == (1, 10, 2)


def test_every_segment_of_the_recording_has_as_many_stretches_as_the_others() -> None:
    test = car_transitions([200, 30, 200, 30])
    truth = replay(test, episodes=8, steps=10, segments=("long", "short"))
    assert {name: int(members.sum()) for name, members in truth.groups.items()} == {"all": 8, "long": 4, "short": 4}
    from_long = {tuple(row) for row in test.observation[(test.episode == test.episode[0])].tolist()}
    from_long |= {tuple(row) for row in test.observation[230:430].tolist()}
    found = [tuple(row) in from_long for row in truth.states[:, 0].tolist()]
    assert truth.groups["long"].tolist() == found


def test_a_segment_with_few_stretches_leaves_its_share_to_the_others() -> None:
    truth = replay(car_transitions([200, 20]), episodes=12, steps=10, segments=("long", "short"))
    assert {name: int(members.sum()) for name, members in truth.groups.items()} == {"all": 12, "long": 10, "short": 2}


def test_a_segment_without_a_long_episode_is_named_and_the_others_keep_their_length() -> None:
    truth = replay(car_transitions([54, 30, 60, 50]), steps=50, history=6, segments=("a", "b", "c", "b"))
    assert truth.steps == 50
    assert list(truth.groups) == ["all"]
    assert truth.too_short == {"a": 54, "b": 50}
    assert truth.dropped == Dropped(3, 54 + 30 + 50)
    assert truth.select([0]).dropped == truth.dropped


def test_all_stretches_become_shorter_only_if_no_episode_is_long_enough() -> None:
    truth = replay(car_transitions([54, 30, 52, 50]), steps=50, history=6, segments=("a", "b"))
    assert truth.steps == 49
    assert truth.too_short == {"b": 50}


def test_a_segment_may_have_the_name_of_a_group() -> None:
    truth = replay(car_transitions([20, 20]), episodes=4, segments=("all", "wall"))
    assert {name: members.tolist().count(True) for name, members in truth.groups.items()} == {
        "all": 4, "segment_all": 2, "wall": 2
    }  # fmt: skip


@pytest.mark.parametrize("lengths", [[], [1, 1, 1]])
def test_episodes_of_one_step_cannot_be_rolled_out(lengths: list[int]) -> None:
    whole = car_transitions([1, 1, 1])
    test = Transitions(spec=whole.spec, **{name: getattr(whole, name)[: len(lengths)] for name in COLUMNS})
    with pytest.raises(EvaluationError, match=f"of the {len(lengths)} has {int(bool(lengths))} steps") as caught:
        replay(test)
    assert "\n" not in str(caught.value)


@settings(max_examples=30)
@given(space_specs(max_size=6), st.integers(0, 2**31 - 1), st.integers(1, 3))
def test_a_perfect_model_has_no_error_whatever_the_spaces(spec: SpaceSpec, seed: int, history: int) -> None:
    truth = replay(moderate(spec, [14, 32], seed), episodes=4, history=history)
    squared, predicted = rollout_errors(Perfect(truth), truth, "argmax")  # type: ignore[arg-type] # all that is used
    summary = summarise_rollouts(squared, predicted, truth, spec.observation)["groups"]
    assert list(summary) == ["all"]
    assert (summary["all"]["episodes"], summary["all"]["rollouts"]) == (2, 4)
    assert all(spread["max"] == 0.0 for spread in summary["all"]["mse"].values())


@settings(max_examples=30)
@given(space_specs(max_size=6), st.integers(0, 2**31 - 1))
def test_a_model_is_rolled_out_under_the_recorded_actions_whatever_the_spaces(spec: SpaceSpec, seed: int) -> None:
    world = moderate(spec, [40, 30], seed)
    model, truth = untrained_model(world), replay(world, steps=12)
    squared, predicted = rollout_errors(model, truth, "argmax")
    state = truth.states[:, 0].astype(np.float32)
    for step in range(truth.steps):
        exogenous = None if truth.exogenous is None else truth.exogenous[:, step]
        state = model.predict(state, truth.actions[:, step], exogenous=exogenous)
        np.testing.assert_array_equal(predicted[:, step], state)
        np.testing.assert_allclose(squared[:, step], (state.astype(float) - truth.states[:, step + 1]) ** 2)


def test_a_model_with_a_history_sees_the_true_frames_first_and_its_own_after_them() -> None:
    world = swing((40, 30))
    model, truth = untrained_model(world, history=3), replay(world, steps=12, history=3)
    squared, predicted = rollout_errors(model, truth, "argmax")
    frames = truth.history_states.astype(np.float32)
    actions = np.concatenate([truth.history_actions, truth.actions], axis=1)
    for step in range(truth.steps):
        state = model.predict(frames, actions[:, step : step + 3])
        np.testing.assert_array_equal(predicted[:, step], state)
        np.testing.assert_allclose(squared[:, step], (state.astype(float) - truth.states[:, step + 1]) ** 2)
        frames = np.concatenate([frames[:, 1:], state[:, None]], axis=1)


def predicted(model: AddressedDynamics, truth: TrueRollouts) -> np.ndarray:
    candidate = Candidate("a model", "a model", 1, predictor_of(model, "argmax"), model, "argmax")
    return roll_out([candidate], truth, cores=1)["a model"]


@pytest.mark.parametrize(("steps", "horizons"), [(2, [1, 2]), (50, range(2, 51, 2)), (300, range(10, 301, 10))])
def test_short_rollouts_have_a_table_of_errors_against_the_horizon_too(steps: int, horizons: list[int]) -> None:
    world = swing((300, 310))
    model = untrained_model(world)
    truth = replay(world, steps=steps)
    found, scale = predicted(model, truth), np.array(model.features.scale)
    _, rows = evaluate_rollouts("ensemble/argmax", found, truth, world.spec, scale, physics=False)
    assert [row["horizon"] for row in rows] == list(horizons)
    assert all(left["horizon"] < right["horizon"] for left, right in pairwise(rows))


@pytest.mark.parametrize("history", [1, 3])
def test_one_stretch_in_the_middle_stands_for_all_in_the_figures(history: int) -> None:
    world = swing((40, 30))
    model, truth = untrained_model(world, history=history), replay(world, steps=12, history=history)
    whole = predicted(model, truth)
    arrays = figure_arrays(model, model.ensemble, Points.of(world, model.features), truth, whole, "mse")
    assert arrays["rollout_group"].tolist() == ["all"]
    np.testing.assert_array_equal(arrays["rollout_true"], truth.states[[len(truth.states) // 2]])
    assert arrays["rollout_predicted"].shape == arrays["rollout_true"].shape
    np.testing.assert_array_equal(arrays["rollout_predicted"][:, 1:], whole[[len(whole) // 2]])


@pytest.mark.parametrize("cores", [1, 3, 64])
def test_rollouts_side_by_side_are_those_of_each_candidate_alone_and_leave_torch_its_threads(cores: int) -> None:
    world = swing((40, 30))
    truth = replay(world, steps=12)
    models = {0: {"plain": untrained_model(world), "cost_sensitive": untrained_model(world, seed=1)}}
    candidates = ensemble_candidates(models, {0: "plain"})
    threads = torch.get_num_threads()
    found = roll_out(candidates, truth, cores=cores)
    assert list(found) == [each.name for each in candidates if each.name != MEAN]
    for each in candidates:
        if each.model is not None:
            np.testing.assert_array_equal(found[each.name], free_run(each.model, truth, each.mode))
    assert torch.get_num_threads() == threads
    assert roll_out([], truth, cores=cores) == {}


def test_a_params_file_says_where_rollouts_come_from() -> None:
    test = drive((40, 30))
    recorded = RecordedRollouts(kind="recorded", episodes=2, steps=10, seed=0)
    segments = dict.fromkeys(test.episode.tolist(), "driving")
    expected = replay_recorded(recorded, test, 3, segments)
    np.testing.assert_array_equal(true_rollouts(recorded, test, 3, segments).states, expected.states)
    environment = EnvironmentParams(id="addressed_dynamics/MountainCarContinuing-v0", kwargs={})
    driven = EnvironmentRollouts(
        kind="environment", environment=environment, episodes=3, steps=10, seed=0, swing_share=0.5, mean_hold_steps=2
    )
    assert list(true_rollouts(driven, test, 3, segments).groups) == ["all", "no_wall", "wall"]
    assert true_rollouts(driven, test, 3, segments).history_states.shape == (3, 3, 2)
