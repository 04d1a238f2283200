"""Behaviours that do not learn: random actions that are held, and constant ones."""

import numpy as np
import pytest
from gymnasium import spaces
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import RecordingError
from addressed_dynamics.base.params.recording import SignBehaviour
from addressed_dynamics.envs import MountainCarContinuing, mountain_car_step
from addressed_dynamics.recording.behaviours import (
    HeldActions,
    Policy,
    constant_policy,
    mostly,
    random_policy,
    sign_policy,
    unlearned_policy,
)

DISCRETE = spaces.Discrete(3)
BOX = spaces.Box(np.float32([-1, 0]), np.float32([1, 5]))
NOTHING = np.zeros((4, 2), dtype=np.float32)


def run(policy: Policy, steps: int) -> np.ndarray:
    return np.array([policy(NOTHING) for _ in range(steps)])


def generator(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


@given(st.floats(1, 30), st.floats(0, 1), st.integers(0, 100))
def test_a_share_of_the_steps_is_random_however_long_actions_are_held(hold: float, share: float, seed: int) -> None:
    held = HeldActions(spaces.Discrete(2, start=7), 200, hold, generator(seed))
    own = np.zeros(200, dtype=np.int64)
    # The first steps are not yet in balance: no copy begins in the middle of a hold.
    random = np.array([held.replace(own, share) != 0 for _ in range(250)])[100:]
    assert random.mean() == pytest.approx(share, abs=0.12)


def test_a_random_policy_draws_all_actions_and_holds_them_for_the_mean_time() -> None:
    actions = run(random_policy(DISCRETE, 4, 10.0, generator()), 20_000)
    assert np.bincount(actions.ravel()) / actions.size == pytest.approx([1 / 3] * 3, abs=0.03)
    # A new draw repeats the old action once in three times.
    changes = (np.diff(actions, axis=0) != 0).mean()
    assert changes == pytest.approx(2 / 3 / 10, rel=0.1)


def test_a_hold_of_one_step_is_a_new_draw_every_step() -> None:
    actions = run(random_policy(DISCRETE, 4, 1.0, generator()), 5_000)
    assert (np.diff(actions, axis=0) != 0).mean() == pytest.approx(2 / 3, abs=0.02)


def test_random_actions_of_a_box_fill_it() -> None:
    actions = run(random_policy(BOX, 4, 1.0, generator()), 2_000).reshape(-1, 2)
    assert actions.dtype == np.float32
    assert actions.min(axis=0) == pytest.approx([-1, 0], abs=0.05)
    assert actions.max(axis=0) == pytest.approx([1, 5], abs=0.05)


def test_the_same_seed_gives_the_same_actions_and_copies_differ() -> None:
    first, again, other = (run(random_policy(DISCRETE, 4, 3.0, generator(seed)), 50) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()
    assert (first[:, 0] != first[:, 1]).any()


def test_without_a_random_share_the_policy_acts_alone_and_its_arrays_are_left_alone() -> None:
    actions = np.array([0, 1, 2, 0])
    held = HeldActions(DISCRETE, 4, 5.0, generator())
    np.testing.assert_array_equal(run(mostly(lambda _: actions, held, 0.0), 50), np.tile(actions, (50, 1)))
    run(mostly(lambda _: actions, held, 1.0), 50)
    assert actions.tolist() == [0, 1, 2, 0]


def test_held_actions_reach_the_goal_of_mountain_car_and_unheld_ones_do_not() -> None:
    def share_at_goal(hold: float) -> float:
        policy = random_policy(DISCRETE, 500, hold, generator())
        state = np.stack([generator().uniform(-0.6, -0.4, 500), np.zeros(500)], axis=1)
        reached = np.zeros(500, dtype=bool)
        for _ in range(200):
            state = mountain_car_step(state, policy(state))
            reached |= state[:, 0] >= 0.5
        return float(reached.mean())

    assert share_at_goal(1.0) == 0
    assert share_at_goal(20.0) > 0.05


def test_a_constant_policy_takes_its_action_in_all_copies() -> None:
    assert run(constant_policy(DISCRETE, 4, 2), 3).tolist() == [[2] * 4] * 3
    np.testing.assert_array_equal(run(constant_policy(BOX, 2, (0.5, 1.0)), 1)[0], np.float32([[0.5, 1.0]] * 2))


def test_a_sign_policy_follows_the_sign_of_one_component_of_each_copy() -> None:
    observations = np.array([[1.0, -0.5], [-1.0, 0.0], [-1.0, 3.0], [1.0, -0.0]])
    assert sign_policy(DISCRETE, 1, 0, 2)(observations).tolist() == [0, 2, 2, 2]
    assert sign_policy(DISCRETE, 0, 0, 2)(observations).tolist() == [2, 0, 0, 2]
    found = sign_policy(BOX, 1, (-1.0, 0.0), (1.0, 5.0))(observations[:2])
    np.testing.assert_array_equal(found, np.float32([[-1, 0], [1, 5]]), strict=True)
    with pytest.raises(RecordingError, match=r"expected the action 'positive' in Discrete\(3\), found 3"):
        sign_policy(DISCRETE, 1, 0, 3)


def test_a_push_in_the_direction_of_motion_reaches_the_goal_of_mountain_car() -> None:
    behaviour = SignBehaviour(kind="sign", dimension="velocity", negative=0, positive=2)
    policy = unlearned_policy(behaviour, MountainCarContinuing(), 3, generator())
    state = np.array([[-0.6, 0.0], [-0.5, 0.0], [-0.4, 0.0]])
    highest = state[:, 0]
    for _ in range(200):
        state = mountain_car_step(state, policy(state))
        highest = np.maximum(highest, state[:, 0])
    assert (highest >= 0.5).all()


@pytest.mark.parametrize("action", [3, -1, (0.0,), (0.0, 0.0)])
def test_a_constant_action_outside_the_space_is_refused(action: int | tuple[float, ...]) -> None:
    with pytest.raises(RecordingError, match=r"expected a constant action in Discrete\(3\), found"):
        constant_policy(DISCRETE, 1, action)


def test_a_vector_of_the_wrong_length_or_beyond_the_bounds_is_refused() -> None:
    for action in (1, (0.0,), (0.0, 6.0)):
        with pytest.raises(RecordingError, match="expected a constant action in Box"):
            constant_policy(BOX, 1, action)


@pytest.mark.parametrize("space", [spaces.Box(-np.inf, np.inf, (2,)), spaces.MultiBinary(3)])
def test_random_actions_of_a_space_without_bounds_are_refused(space: spaces.Space) -> None:
    with pytest.raises(RecordingError, match="random actions need a discrete or a bounded action space"):
        random_policy(space, 2, 1.0, generator())
