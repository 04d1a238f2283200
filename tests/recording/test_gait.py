"""Gaits: joints drawn after sines, without an environment that has any."""

from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import GaitBehaviour
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec
from addressed_dynamics.recording.behaviours import Policy
from addressed_dynamics.recording.gait import GaitPolicy

STATE = ("height", "hip", "knee", "hip_velocity", "knee_velocity")
NAMES = SpaceSpec(
    observation=tuple(Dimension(name, "", -np.inf, np.inf) for name in STATE),
    action=ContinuousAction(tuple(Dimension(name, "", -1.0, 1.0) for name in ("hip_torque", "knee_torque"))),
    step_seconds=0.01,
)
BOX = spaces.Box(-1, 1, (2,), dtype=np.float32)
HIP = {"angle": "hip", "velocity": "hip_velocity", "centre": 0.1, "swing": 0.2}
KNEE = {"angle": "knee", "velocity": "knee_velocity", "centre": -0.3, "swing": 0.1, "phase": np.pi / 2}


def policy(copies: int = 2, seed: int = 0, space: spaces.Space = BOX, **changes: Any) -> GaitPolicy:
    section = {"kind": "gait", "joints": {"hip": HIP, "knee": KNEE}, "period_steps": 40.0, "stiffness": 2.0} | changes
    params = GaitBehaviour.model_validate(section)
    return GaitPolicy(params, NAMES, space, copies, np.random.default_rng(seed))


def run(act: Policy, steps: int, copies: int = 2) -> np.ndarray:
    """Actions (step, copy, joint) in a state in which all is 0."""
    return np.array([act(np.zeros((copies, len(STATE)))) for _ in range(steps)])


def test_every_joint_is_drawn_after_its_own_sine() -> None:
    actions = run(policy(mean_gait_steps=1e9), 100)
    turn = 2 * np.pi * np.arange(100) / 40
    wanted = np.stack([0.1 + 0.2 * np.sin(turn), -0.3 + 0.1 * np.cos(turn)], axis=1)
    np.testing.assert_allclose(actions, np.repeat(2 * wanted[:, None], 2, axis=1), atol=1e-6)
    assert actions.dtype == np.float32


def test_a_spring_draws_to_the_sine_and_a_damper_against_the_velocity() -> None:
    states = np.array([[9.0, 0.1, -0.2, 0.0, 0.0], [9.0, 0.2, -0.2, 0.5, -1.0]])
    actions = policy(damping=0.1)(states)
    np.testing.assert_allclose(actions, [[0.0, 0.0], [-0.2 - 0.05, 0.0 + 0.1]], atol=1e-6)


def test_actions_stay_in_the_bounds_of_the_environment() -> None:
    low, high = np.float32([-0.1, -1]), np.float32([0.05, 1])
    actions = run(policy(space=spaces.Box(low, high), stiffness=1000.0), 200)
    assert (actions >= low).all()
    assert (actions <= high).all()
    assert set(actions[..., 0].ravel()) == {low[0], high[0]}
    assert actions[..., 1].min() == low[1]


def test_without_variation_all_copies_have_the_same_gait_and_with_it_each_its_own() -> None:
    same, own = run(policy(mean_gait_steps=1e9), 50), run(policy(mean_gait_steps=1e9, variation=0.2), 50)
    np.testing.assert_array_equal(same[:, 0], same[:, 1])
    assert np.abs(own[:, 0] - own[:, 1]).max() > 0.02


def test_a_gait_lasts_for_the_mean_time_and_the_next_begins_anew() -> None:
    # A sine of so long a period stays where it begins: an action changes when, and only when, a gait begins.
    act = policy(copies=100, period_steps=1e9, variation=0.2, mean_gait_steps=20.0)
    actions = run(act, 500, copies=100)
    changes = (np.abs(np.diff(actions[:, :, 0], axis=0)) > 1e-5).mean()
    assert changes == pytest.approx(1 / 20, rel=0.1)


def test_an_episode_begins_with_a_gait_of_its_own_and_the_other_copies_go_on() -> None:
    act, alone = (policy(period_steps=1e9, variation=0.2, mean_gait_steps=1e9) for _ in range(2))
    before = run(act, 10)
    act.begin(1)
    after = run(act, 10)
    np.testing.assert_array_equal(run(alone, 20)[:, 0], np.concatenate([before, after])[:, 0])
    assert np.abs(after[:, 1] - before[:, 1]).min() > 1e-3
    np.testing.assert_allclose(after[:, 1], np.tile(after[0, 1], (10, 1)), atol=1e-6)


def test_noise_has_its_share_of_half_of_the_range() -> None:
    actions = run(policy(copies=100, period_steps=1e9, noise=0.1, mean_gait_steps=1e9), 200, copies=100)
    assert actions[..., 0].std() == pytest.approx(0.1, rel=0.05)
    assert actions[..., 0].mean() == pytest.approx(0.2, abs=0.01)


def test_the_same_seed_gives_the_same_actions_and_another_gives_others() -> None:
    first, again, other = (run(policy(seed=seed, variation=0.2, noise=0.1), 50) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize(
    "space", [spaces.Discrete(2), spaces.Box(-1, 1, (3,)), spaces.Box(-np.inf, 1, (2,)), spaces.Box(-1, 1, (2, 1))]
)
def test_a_gait_that_does_not_fit_the_actions_is_refused(space: spaces.Space) -> None:
    with pytest.raises(RecordingError, match=r"a bounded action for each of its joints \(hip, knee\), but"):
        policy(space=space)


def test_a_joint_that_is_no_dimension_of_the_state_is_refused() -> None:
    joints = {"hip": HIP, "knee": KNEE | {"velocity": "knee_speed"}}
    with pytest.raises(RecordingError, match=r"names 'knee_speed', which is no dimension of the state \(height, hip,"):
        policy(joints=joints)
