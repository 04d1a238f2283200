"""Acrobot with a settable step: Gymnasium's where the settings are Gymnasium's, and energy that stays."""

import gymnasium
import numpy as np
import pytest
from gymnasium.envs.classic_control.acrobot import AcrobotEnv
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import SpaceError
from addressed_dynamics.envs import (
    ACROBOT,
    Acrobot,
    acrobot_energy,
    acrobot_observation,
    acrobot_reward,
    acrobot_state,
    acrobot_step,
)
from addressed_dynamics.episodes.transitions import DiscreteAction
from addressed_dynamics.recording.spaces import space_spec

WIDE = {"start_angle": (-np.pi, np.pi), "start_velocity": (-4.0, 4.0)}


@given(st.integers(0, 2**16))
def test_with_gymnasiums_time_step_it_is_gymnasiums_environment(seed: int) -> None:
    ours, theirs = Acrobot(time_step=0.2), AcrobotEnv()
    ours.reset(seed=seed)
    theirs.reset(seed=seed)
    theirs.state = ours.state.copy()
    for action in np.random.default_rng(seed).integers(0, 3, 20).tolist():
        found, expected = ours.step(action), theirs.step(action)
        np.testing.assert_array_equal(found[0], expected[0])
        assert found[1:] == expected[1:]


@given(st.integers(0, 2**16), st.sampled_from([0.01, 0.02, 0.2]))
def test_a_step_of_many_states_is_the_step_of_the_environment(seed: int, time_step: float) -> None:
    env, generator = Acrobot(time_step=time_step, ends_at_goal=False), np.random.default_rng(seed)
    low, high = np.array([np.pi, np.pi, env.MAX_VEL_1, env.MAX_VEL_2]) * np.array([[-1.0], [1.0]])
    states, actions = generator.uniform(low, high, (20, 4)), generator.integers(0, 3, 20)
    shown, after = [], []
    env.reset(seed=seed)
    for state, action in zip(states, actions.tolist(), strict=True):
        env.state = state.copy()
        shown.append(env.step(action)[0])
        after.append(env.state)
    found = acrobot_step(states, actions, time_step)
    np.testing.assert_allclose(found, after, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(acrobot_observation(found), shown, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(acrobot_step(states[7], actions[7], time_step), found[7], rtol=0.0, atol=1e-12)


def test_many_steps_stay_with_the_environment_and_within_its_bounds() -> None:
    env = Acrobot(ends_at_goal=False, **WIDE)
    env.reset(seed=5)
    state = np.array(env.state)
    for action in np.random.default_rng(5).integers(0, 3, 300):
        env.step(int(action))
        state = acrobot_step(state, action, 0.02)
        np.testing.assert_allclose(state, env.state, rtol=0.0, atol=1e-9)
    assert (np.abs(state) <= [np.pi, np.pi, env.MAX_VEL_1, env.MAX_VEL_2]).all()


@given(st.lists(st.floats(-3.14, 3.14), min_size=4, max_size=4))
def test_a_state_is_found_again_in_its_observation(numbers: list[float]) -> None:
    state = np.array(numbers)
    np.testing.assert_allclose(acrobot_state(acrobot_observation(state)), state, rtol=0.0, atol=1e-14)
    twice = acrobot_observation(state) * [2.0, 2.0, 0.5, 0.5, 1.0, 1.0]
    np.testing.assert_allclose(acrobot_state(twice), state, rtol=0.0, atol=1e-14)


def drift(time_step: float, seconds: float, seed: int, link_masses: tuple[float, float] = (1.0, 1.0)) -> float:
    """The largest change of energy at zero torque, relative to the energy of the fall from the top."""
    env = Acrobot(time_step=time_step, ends_at_goal=False, link_masses=link_masses, **WIDE)
    env.reset(seed=seed)
    states = [np.asarray(env.state, dtype=np.float64)]
    for _ in range(round(seconds / time_step)):
        env.step(1)
        states.append(np.asarray(env.state, dtype=np.float64))
    energy = acrobot_energy(np.array(states), link_masses)
    bounded = np.abs(states)[:, 2:].max(axis=0) >= np.array([env.MAX_VEL_1, env.MAX_VEL_2])
    assert not bounded.any(), "a bounded velocity loses energy"
    top, bottom = acrobot_energy(np.array([[np.pi, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0]]), link_masses)
    return float(np.abs(energy - energy[0]).max() / (top - bottom))


@pytest.mark.parametrize("seed", range(4))
def test_energy_is_conserved_to_the_accuracy_of_the_integration(seed: int) -> None:
    coarse, fine = drift(0.02, 10.0, seed), drift(0.01, 10.0, seed)
    assert coarse < 1e-4
    # Of fourth order: half the step makes a sixteenth of the error in a step, and twice as many steps.
    assert fine < coarse / 8


@pytest.mark.parametrize("link_masses", [(1.0, 1.5), (0.5, 3.0)])
def test_with_heavier_links_their_own_energy_is_conserved(link_masses: tuple[float, float]) -> None:
    assert drift(0.01, 5.0, 0, link_masses) < 1e-4


def test_what_a_heavier_link_weighs_is_lifted_with_it() -> None:
    hanging, lifted = np.array([[0.0, 0.0, 0.0, 0.0], [0.0, np.pi, 0.0, 0.0]])
    for mass in (1.0, 2.0):
        energy = acrobot_energy(np.stack([hanging, lifted]), (1.0, mass))
        # The middle of the second link rises from 1.5 m below the hinge to 0.5 m below it.
        assert energy[1] - energy[0] == pytest.approx(mass * 9.8 * 1.0)


@given(st.integers(0, 2**16), st.floats(0.2, 5.0), st.floats(0.2, 5.0))
def test_a_step_with_other_masses_is_the_step_of_that_environment(seed: int, mass_1: float, mass_2: float) -> None:
    env, generator = Acrobot(ends_at_goal=False, link_masses=(mass_1, mass_2)), np.random.default_rng(seed)
    state, action = generator.uniform(-3.0, 3.0, 4), int(generator.integers(0, 3))
    env.reset(seed=seed)
    env.state = state.copy()
    env.step(action)
    found = acrobot_step(state, np.array(action), 0.02, (mass_1, mass_2))
    np.testing.assert_allclose(found, env.state, rtol=0.0, atol=1e-12)


def test_masses_are_an_environments_own_and_by_default_gymnasiums() -> None:
    Acrobot(link_masses=(2.0, 3.0))
    ours = Acrobot()
    assert (ours.LINK_MASS_1, ours.LINK_MASS_2) == (AcrobotEnv.LINK_MASS_1, AcrobotEnv.LINK_MASS_2) == (1.0, 1.0)


def test_the_end_at_the_goal_is_a_choice() -> None:
    for ends in (True, False):
        env = Acrobot(ends_at_goal=ends)
        env.reset(seed=0)
        env.state = np.array([np.pi, 0.0, 0.0, 0.0])
        assert env.step(1)[2] is ends


def test_noise_is_drawn_from_the_seed_and_changes_the_motion() -> None:
    def after(noise: float, seed: int) -> np.ndarray:
        env = Acrobot(torque_noise=noise)
        env.reset(seed=seed)
        return np.array([env.step(1)[0] for _ in range(20)])

    np.testing.assert_array_equal(after(0.5, 3), after(0.5, 3))
    assert (after(0.5, 3) != after(0.0, 3)).any()


def test_first_states_come_from_the_start_ranges() -> None:
    env = Acrobot(start_angle=(1.0, 1.5), start_velocity=(-2.0, -1.0))
    states = []
    for seed in range(50):
        env.reset(seed=seed)
        states.append(env.state)
    low, high = np.min(states, axis=0), np.max(states, axis=0)
    assert (low >= [1.0, 1.0, -2.0, -2.0]).all()
    assert (high <= [1.5, 1.5, -1.0, -1.0]).all()


def test_its_numbers_are_described() -> None:
    env = gymnasium.make(ACROBOT, time_step=0.05)
    spec = space_spec(env)
    assert spec.step_seconds == 0.05
    assert spec.observation_names[4:] == ("velocity_1", "velocity_2")
    assert isinstance(spec.action, DiscreteAction)
    assert space_spec(gymnasium.make(ACROBOT)).step_seconds == 0.02


@pytest.mark.parametrize(
    "wrong",
    [
        {"time_step": 0.0},
        {"torque_noise": -1.0},
        {"start_angle": (1.0, 0.0)},
        {"start_velocity": (0.0, 99.0)},
        {"link_masses": (1.0, 0.0)},
        {"link_masses": (1.0,)},
    ],
)
def test_settings_that_make_no_acrobot_are_one_clear_error(wrong: dict[str, object]) -> None:
    with pytest.raises(SpaceError, match=next(iter(wrong))):
        Acrobot(**wrong)


@given(st.integers(0, 2**16))
def test_the_reward_and_the_end_are_gymnasiums_acrobots(seed: int) -> None:
    env = Acrobot(time_step=0.2, **WIDE)
    before, _ = env.reset(seed=seed)
    after, reward, terminated, _, _ = env.step(seed % 3)
    found = acrobot_reward(before[None], np.array([seed % 3]), after[None])
    assert (float(found[0][0]), bool(found[1][0])) == (reward, terminated)
