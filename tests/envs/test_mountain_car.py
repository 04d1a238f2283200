"""The continuing MountainCar and its vectorised dynamics, held against Gymnasium's environment."""

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control.mountain_car import MountainCarEnv
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import SpaceError
from addressed_dynamics.envs import (
    CONTINUING_MOUNTAIN_CAR,
    MountainCarContinuing,
    mountain_car_reward,
    mountain_car_step,
)

positions = st.floats(-1.2, 0.6)
velocities = st.floats(-0.07, 0.07)
actions = st.integers(0, 2)


@given(st.lists(st.tuples(positions, velocities, actions), min_size=1, max_size=20))
def test_the_kernel_equals_gymnasiums_step_bit_for_bit(cases: list[tuple[float, float, int]]) -> None:
    env = MountainCarEnv()
    expected = []
    for position, velocity, action in cases:
        env.state = (position, velocity)
        env.step(action)
        expected.append([float(value) for value in env.state])
    states = np.array([case[:2] for case in cases])
    np.testing.assert_array_equal(mountain_car_step(states, np.array([case[2] for case in cases])), expected)


@given(st.integers(0, 2**16))
def test_the_kernel_follows_the_environment_for_a_whole_episode(seed: int) -> None:
    env = MountainCarContinuing()
    env.reset(seed=seed)
    state = np.array([env.state], dtype=np.float64)
    for action in np.random.default_rng(seed).integers(0, 3, 50):
        state = mountain_car_step(state, np.array([action]))
        observation = env.step(action)[0]
        np.testing.assert_array_equal(observation, state[0].astype(np.float32))


@given(st.floats(0.0, 0.01), st.floats(0.0, 0.01), st.integers(0, 2**16))
def test_a_changed_engine_and_slope_change_the_equations_as_they_say(force: float, gravity: float, seed: int) -> None:
    env = MountainCarContinuing(force=force, gravity=gravity)
    env.reset(seed=seed)
    generator = np.random.default_rng(seed)
    for action in generator.integers(0, 3, 20):
        # Away from walls and the speed limit, where nothing but the equations acts.
        position, velocity = env.state = generator.uniform([-0.9, -0.04], [0.4, 0.04])
        env.step(action)
        expected = velocity + (action - 1) * force - gravity * np.cos(3 * position)
        np.testing.assert_allclose(env.state, [position + expected, expected], rtol=0, atol=1e-15)
        found = mountain_car_step(np.array([[position, velocity]]), np.array([action]), force, gravity)
        np.testing.assert_array_equal(found[0], env.state)


def test_by_default_engine_and_slope_are_gymnasiums() -> None:
    ours, theirs = MountainCarContinuing(), MountainCarEnv()
    assert (ours.force, ours.gravity) == (theirs.force, theirs.gravity)


@pytest.mark.parametrize("wrong", [{"force": -0.001}, {"gravity": 1.0}, {"force": float("nan")}])
def test_an_engine_or_a_slope_that_no_car_has_is_one_clear_error(wrong: dict[str, float]) -> None:
    with pytest.raises(SpaceError, match=rf"^{next(iter(wrong))} should be a number in 0..0.07, but is [^\n]*$"):
        MountainCarContinuing(**wrong)


@given(position=positions, velocity=st.floats(-0.07, -1e-6))
def test_the_left_wall_stops_the_car_and_the_right_wall_keeps_its_velocity(position: float, velocity: float) -> None:
    left = mountain_car_step(np.array([[-1.2, velocity]]), np.array([0]))[0]
    assert left[0] == -1.2 or left[1] > 0
    assert not (left[0] == -1.2 and left[1] < 0)
    right = mountain_car_step(np.array([[0.6, -velocity + 0.01]]), np.array([2]))[0]
    assert right[0] == 0.6
    assert right[1] > 0
    assert mountain_car_step(np.array([[position, velocity]]), np.array([1])).dtype == np.float64


def test_an_episode_does_not_end_at_the_goal_and_ends_at_the_time_limit() -> None:
    env = gymnasium.make(
        CONTINUING_MOUNTAIN_CAR, max_episode_steps=30, start_position=[0.45, 0.45], start_velocity=[0.05, 0.05]
    )
    env.reset(seed=0)
    results = [env.step(2) for _ in range(30)]
    assert max(result[0][0] for result in results) == np.float32(0.6)
    assert not any(result[2] for result in results)
    assert [result[3] for result in results] == [False] * 29 + [True]


def test_first_states_fill_the_given_ranges_and_repeat_with_the_seed() -> None:
    env = gymnasium.make(CONTINUING_MOUNTAIN_CAR, start_position=[-1.2, 0.6], start_velocity=[-0.07, 0.07])
    starts = np.array([env.reset(seed=seed)[0] for seed in range(300)])
    np.testing.assert_array_equal(starts, [env.reset(seed=seed)[0] for seed in range(300)])
    assert starts.min(axis=0) == pytest.approx([-1.2, -0.07], abs=0.02)
    assert starts.max(axis=0) == pytest.approx([0.6, 0.07], abs=0.02)


def test_by_default_the_car_starts_where_gymnasiums_does() -> None:
    env = gymnasium.make(CONTINUING_MOUNTAIN_CAR)
    starts = np.array([env.reset(seed=seed)[0] for seed in range(100)])
    assert starts[:, 0].min() >= -0.6
    assert starts[:, 0].max() <= -0.4
    np.testing.assert_array_equal(starts[:, 1], 0)


@pytest.mark.parametrize("bad", [[-1.3, 0.0], [0.2, 0.1], [0.1], [float("nan"), 0.1]])
def test_a_start_range_outside_the_track_is_refused(bad: list[float]) -> None:
    with pytest.raises(SpaceError, match="start_position should be two increasing numbers"):
        gymnasium.make(CONTINUING_MOUNTAIN_CAR, start_position=bad)


def test_the_environment_says_what_its_numbers_mean() -> None:
    env = gymnasium.make(CONTINUING_MOUNTAIN_CAR)
    meaning = env.metadata["addressed_dynamics"]
    assert [name for name, _ in meaning["observation"]] == ["position", "velocity"]
    assert len(meaning["action"]) == env.action_space.n
    assert meaning["step_seconds"] == pytest.approx(1 / 30)


@given(st.floats(0.3, 0.6), velocities, actions)
def test_the_reward_and_the_end_are_gymnasiums(position: float, velocity: float, action: int) -> None:
    env = MountainCarEnv()
    env.state = (position, velocity)
    _, reward, terminated, _, _ = env.step(action)
    found = mountain_car_reward(np.array([[position, velocity]]), np.array([action]), np.array([env.state]))
    assert (float(found[0][0]), bool(found[1][0])) == (reward, terminated)
