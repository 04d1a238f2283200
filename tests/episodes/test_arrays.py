"""Transitions from arrays and data frames."""

from typing import Any

import numpy as np
import pandas as pd
import polars
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.episodes.transitions import ContinuousAction, DiscreteAction, Transitions

STATE = np.arange(12.0).reshape(6, 2)
PUSH = np.array([0, 1, 2, 0, 1, 2])
EPISODES = [7, 7, 7, 9, 9, 9]


def made(observations: Any = STATE, actions: Any = PUSH, **options: Any) -> Transitions:
    return Transitions.from_arrays(observations, actions, **({"rate_hz": 10.0, "episodes": EPISODES} | options))


def test_rows_are_samples_and_the_last_of_an_episode_is_only_a_next_observation() -> None:
    transitions = made(rewards=[1, 2, 3, 4, 5, 6])
    assert transitions.observation.tolist() == STATE[[0, 1, 3, 4]].tolist()
    assert transitions.next_observation.tolist() == STATE[[1, 2, 4, 5]].tolist()
    assert transitions.action.tolist() == [0, 1, 0, 1]
    assert transitions.reward.tolist() == [1, 2, 4, 5]
    assert transitions.episode.tolist() == [7, 7, 9, 9]
    assert transitions.step.tolist() == [0, 1, 0, 1]
    assert transitions.truncated.tolist() == [False, True, False, True]
    assert transitions.spec.step_seconds == 0.1
    assert transitions.spec.action == DiscreteAction(("action_0", "action_1", "action_2"))


def test_next_observations_make_every_row_a_transition() -> None:
    after = np.concatenate([STATE[1:3], [[50, 51]], STATE[4:], [[60, 61]]])
    transitions = made(next_observations=after, terminated=[0, 0, 1, 0, 0, 0])
    assert transitions.next_observation.tolist() == after.tolist()
    assert transitions.terminated.tolist() == [False, False, True, False, False, False]
    assert transitions.truncated.tolist() == [False] * 5 + [True]


@pytest.mark.parametrize("frame", [pd.DataFrame, polars.DataFrame])
def test_columns_of_data_frames_name_the_dimensions(frame: Any) -> None:
    transitions = made(frame({"q": STATE[:, 0], "v": STATE[:, 1]}), frame({"u": PUSH / 2}))
    assert transitions.spec.observation_names == ("q", "v")
    assert isinstance(transitions.spec.action, ContinuousAction)
    assert [each.name for each in transitions.spec.action.dimensions] == ["u"]
    assert transitions.action[:, 0].tolist() == [0.0, 0.5, 0.0, 0.5]


def test_columns_of_one_data_frame_may_be_taken_from_it() -> None:
    table = pd.DataFrame({"e": list("aaabbb"), "q": STATE[:, 0], "push": ["left", "right"] * 3, "end": [0, 0, 1] * 2})
    transitions = made(
        table[["q"]], table["push"], episodes=table["e"], terminated=table["end"], action_names=["left", "right"]
    )
    assert transitions.action.tolist() == [0, 1, 1, 0]
    assert transitions.episode.tolist() == [0, 0, 1, 1]
    assert transitions.terminated.tolist() == [False, True] * 2


def test_exogenous_inputs_stand_beside_the_actions() -> None:
    transitions = made(exogenous=pd.DataFrame({"wind": PUSH * 2.0}))
    assert [each.name for each in transitions.spec.exogenous] == ["wind"]
    assert transitions.exogenous[:, 0].tolist() == [0.0, 2.0, 0.0, 2.0]


def test_lengths_or_ends_may_separate_episodes() -> None:
    by_length = made(episodes=None, lengths=[3, 3])
    by_end = made(episodes=None, truncated=[0, 0, 1, 0, 0, 0])
    for transitions in (by_length, by_end):
        assert transitions.episode.tolist() == [0, 0, 1, 1]
    assert made(episodes=None).episode.tolist() == [0] * 5


@given(st.lists(st.integers(1, 5), min_size=1, max_size=6))
def test_every_episode_of_k_rows_has_k_minus_one_transitions(lengths: list[int]) -> None:
    count = sum(lengths)
    transitions = made(np.arange(count) * 1.0, np.zeros(count), episodes=None, lengths=lengths)
    found = dict(zip(*np.unique(transitions.episode, return_counts=True), strict=True))
    assert found == {number: length - 1 for number, length in enumerate(lengths) if length > 1}
    np.testing.assert_array_equal(transitions.next_observation - transitions.observation, 1.0)


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"observations": np.zeros((0, 2))}, "observations should have a row per step, but there are none"),
        ({"observations": np.zeros((6, 2, 2))}, "but has the shape (6, 2, 2)"),
        ({"observations": [["a"]] * 6}, "observations should be numbers"),
        ({"observations": np.where(STATE == 4, np.nan, STATE)}, "not finite in row"),
        ({"observations": STATE * 1e300}, "not finite in row"),
        ({"observations": STATE / 1e3 + 5e6}, "float32 cannot hold 'observation_0'"),
        (
            {"observations": pd.DataFrame(STATE, columns=["joint 1", "b"])},
            "joint 1, b; give observation_names",
        ),
        ({"observation_names": ["a"]}, "the 2 dimensions of observation need as many different names"),
        ({"observation_names": ["a", "a"]}, "different names"),
        ({"actions": PUSH[:5]}, "actions should be 6 numbers"),
        ({"actions": np.zeros((5, 1))}, "actions should have 6 rows"),
        ({"actions": PUSH - 1}, "actions should lie in 0..1"),
        ({"actions": PUSH + 0.5, "discrete": True}, "row 0 has 0.5; give discrete=False"),
        ({"actions": list("lrlrlr")}, "such as 'l', that are not in action_names"),
        ({"rate_hz": 0.0}, "rate_hz should be the number of steps in a second, but is 0.0"),
        ({"episodes": [1, 1, 2, 2, 1, 1]}, "episode 1 comes back after another one"),
        ({"episodes": [1, 1]}, "episodes should be 6 identifiers"),
        ({"lengths": [3, 3]}, "give one of them"),
        ({"episodes": None, "lengths": [3, 2]}, "lengths should be the rows of each episode, 6 together"),
        ({"terminated": [0, 1, 0, 0, 0, 0]}, "row 1 is terminated or truncated, but the episode goes on"),
        ({"terminated": [0, 0, 2, 0, 0, 0]}, "terminated should be true or false"),
        ({"rewards": [1.0]}, "rewards should have 6 rows"),
        ({"next_observations": STATE}, "has a next_observation that is not the observation of the step after it"),
    ],
)
def test_what_does_not_make_transitions_is_refused_with_its_place(options: dict[str, Any], what: str) -> None:
    with pytest.raises(TransitionsError) as caught:
        made(**options)
    assert what in str(caught.value)
    assert "\n" not in str(caught.value)
