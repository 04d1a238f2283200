"""What the examples of planning ask for, and the loop they do it in."""

import numpy as np
import pytest
from planning_models import linear_simulator

from addressed_dynamics import CEM
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension
from examples.planning import acrobot, mountaincar, pendulum


def test_a_plan_that_reaches_the_goal_costs_its_steps_and_any_other_more() -> None:
    positions = np.array([[0.1, 0.4, 0.55, 0.3], [0.5, 0.2, 0.2, 0.2], [0.1, 0.2, 0.3, 0.4], [0.1, 0.2, 0.3, 0.2]])
    states = np.stack([positions, np.zeros_like(positions)], axis=-1)
    costs = mountaincar.steps_to_the_goal(states, np.zeros((4, 4)))
    np.testing.assert_allclose(costs, [2.0, 0.0, 14.0, 24.0])


def test_the_tip_of_the_acrobot_must_be_a_metre_above_its_axis() -> None:
    angles = np.array([[[0.0, 0.0], [np.pi, 0.0]], [[np.pi / 2, 0.0], [np.pi / 2, np.pi / 2]]])
    first, both = angles[..., 0], angles[..., 1]
    shown = [np.cos(first), np.sin(first), np.cos(both), np.sin(both), 0 * first, 0 * first]
    costs = acrobot.steps_to_the_goal(np.stack(shown, axis=-1), np.zeros((2, 2)))
    np.testing.assert_allclose(
        costs, [1.0, 2.0], atol=1e-6
    )  # 2 m up after one step; level with 1 m, which is not above


@pytest.mark.parametrize(("target", "cost"), [(0.3, pendulum.staying), (0.3, pendulum.reaching)])
def test_the_cost_of_a_pendulum_falls_towards_its_target(target: float, cost) -> None:
    angles = np.array([[0.0, 0.1], [0.0, 0.2], [0.0, 0.3]])
    costs = cost(target)(np.stack([angles, angles], axis=-1), np.zeros((3, 2, 1)))
    totals = costs.sum(axis=1) if costs.ndim == 2 else costs
    assert (np.diff(totals) < 0.0).all()


def test_the_pendulum_is_pushed_as_the_planner_says() -> None:
    torque = ContinuousAction((Dimension("torque", "N m", -2.0, 2.0),))
    pushed = linear_simulator(np.array([[1.0, 0.0], [0.0, 1.0], [0.1, 0.0]]), torque)
    angles = pendulum.episode(CEM(pushed, pendulum.staying(5.0), horizon=2, samples=20), steps=10, step_seconds=0.05)
    assert angles.shape == (10,)
    assert (np.diff(angles[:4]) > 0.0).all()
    assert 0.3 < angles.max() < 1.7  # the most that any torques reach
