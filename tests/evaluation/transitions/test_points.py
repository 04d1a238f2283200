"""Points: the transitions of which a model can predict the end, with the frames before them."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import drive, swing

from addressed_dynamics.episodes.transitions import COLUMNS, Transitions
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.suite import held_out
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.sources.transitions.params import FeatureParams

WORLDS = {"car": drive((9, 2, 14, 3)), "arm": swing((9, 2, 14, 3))}
histories = st.integers(1, 6)


def points_of(world: Transitions, history: int) -> Points:
    return Points.of(world, fit_features(world, FeatureParams(target="change", history=history)))


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@given(history=histories)
def test_a_point_is_a_transition_with_enough_of_its_episode_before_it(world: Transitions, history: int) -> None:
    points = points_of(world, history)
    rows = [row for row in range(len(world)) if world.step[row] >= history - 1]
    assert len(points) == len(rows)
    assert points.rows.tolist() == rows
    for name in ("observation", "next_observation", "action", "episode", "step"):
        np.testing.assert_array_equal(getattr(points, name), getattr(world, name)[rows], err_msg=name, strict=True)


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@given(history=histories, chosen=st.lists(st.integers(0, 7), max_size=5))
def test_inputs_are_the_frames_that_end_in_a_point(world: Transitions, history: int, chosen: list[int]) -> None:
    points = points_of(world, history)
    observation, action = points.inputs(torch.tensor(chosen, dtype=torch.int64))
    assert observation.shape[0] == action.shape[0] == len(chosen)
    for states, actions, point in zip(observation, action, chosen, strict=True):
        last = points.rows[point]
        frames = slice(last - history + 1, last + 1) if history > 1 else last
        np.testing.assert_array_equal(states, world.observation[frames])
        np.testing.assert_array_equal(actions, world.action[frames])


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@given(history=histories)
def test_points_are_what_training_calls_samples(world: Transitions, history: int) -> None:
    points = points_of(world, history)
    samples = points.features.samples(world)
    x = points.features.encode(*points.inputs(torch.arange(len(points))))
    torch.testing.assert_close(x, samples.x[:], rtol=0.0, atol=0.0)
    assert points.step.tolist() == samples.step.tolist()


def test_held_out_episodes_that_are_too_short_for_the_history_are_counted() -> None:
    world = drive((2, 30, 1, 3))
    short = {"episodes": 2, "rows": 3}
    assert held_out(points_of(world, 3)) == {"transitions": 28 + 1, "episodes": 2, "dropped": short}
    assert held_out(points_of(world, 1))["dropped"] == {"episodes": 0, "rows": 0}


def test_no_transitions_have_no_points() -> None:
    world = WORLDS["car"]
    empty = Transitions(spec=world.spec, **{name: getattr(world, name)[:0] for name in COLUMNS})
    points = Points.of(empty, points_of(world, 3).features)
    assert len(points) == 0
    assert points.observation.shape == (0, 2)
