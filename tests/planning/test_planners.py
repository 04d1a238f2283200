"""Planners against what is optimal, and the bad input that they refuse."""

import itertools
import warnings

import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from planning_models import STEP, A, B, delayed_walk, double_integrator, linear_simulator, walk
from trusted_models import trusted_model

from addressed_dynamics.base.errors import ModelError, PlanningError
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension
from addressed_dynamics.planning import CEM, MPPI, Planner
from addressed_dynamics.planning.mppi import path_weights

Q, R = np.diag([1.0, 0.1]), 0.05
"""Cost of a state x and of a push u: x' Q x + R u²."""


def quadratic(states, actions):
    return np.einsum("bti,ij,btj->bt", states, Q, states) + R * np.square(actions[..., 0])


def to_target(states, actions):
    return np.abs(states[..., 0] - 3.0) + 0.01 * (actions != 1)


def closed_loop(planner: Planner, start, steps: int) -> float:
    """Return what a planner's actions cost in the double integrator itself."""
    state, total = np.array(start), 0.0
    for _ in range(steps):
        push = planner.command(state)
        state = A @ state + B @ push.astype(np.float64)
        total += state @ Q @ state + R * float(push[0]) ** 2
    return total


def lqr_cost(start, steps: int) -> float:
    """Return what the linear-quadratic regulator costs, which no other controller is below over a long time."""
    value = scipy.linalg.solve_discrete_are(A, B, Q, [[R]])
    gain = np.linalg.solve(R + B.T @ value @ B, B.T @ value @ A)
    state, total = np.array(start), 0.0
    for _ in range(steps):
        push = -gain @ state
        state = A @ state + B @ push
        total += state @ Q @ state + R * float(push[0]) ** 2
    return total


def integrator_planner(kind: str, **changes) -> Planner:
    if kind == "cem":
        return CEM(double_integrator(), quadratic, **{"horizon": 20, "samples": 64, "iterations": 4, **changes})
    settings_ = {"horizon": 20, "samples": 64, "iterations": 4, "temperature": 0.1, "noise": 0.1, **changes}
    return MPPI(double_integrator(), quadratic, **settings_)


@pytest.mark.parametrize("kind", ["cem", "mppi"])
def test_a_double_integrator_costs_within_a_tenth_of_what_the_regulator_does(kind: str) -> None:
    start = [1.0, 0.0]
    best = lqr_cost(start, 40)
    assert best <= closed_loop(integrator_planner(kind), start, 40) <= 1.1 * best


@settings(max_examples=15, deadline=None)
@given(
    moves=st.lists(st.floats(-2.0, 2.0), min_size=2, max_size=4),
    start=st.floats(-2.0, 2.0),
    hold=st.sampled_from([1, 2]),
)
def test_categorical_plans_are_the_best_of_all_that_can_be_enumerated(moves, start: float, hold: int) -> None:
    blocks = 4
    planner = CEM(walk(moves), to_target, horizon=blocks * hold, hold=hold, samples=300, iterations=6)
    planner.command([start])
    every = np.repeat(np.array(list(itertools.product(range(len(moves)), repeat=blocks))), hold, axis=1)
    states = start + np.cumsum(np.array(moves)[every], axis=1)
    least = to_target(states[..., None], every).sum(axis=1).min()
    assert planner.plan.cost == pytest.approx(least, abs=1e-4)


@pytest.mark.parametrize("kind", ["cem", "mppi"])
def test_a_warm_start_improves_what_a_small_search_finds(kind: str) -> None:
    small = {"samples": 24, "iterations": 1}
    warm, cold = (
        sum(
            closed_loop(integrator_planner(kind, warm_start=each, seed=seed, **small), [1.0, 0.0], 25)
            for seed in range(3)
        )
        for each in (True, False)
    )
    assert warm < 0.95 * cold


@pytest.mark.parametrize("kind", ["cem", "mppi"])
def test_the_same_seed_gives_the_same_actions_and_another_others(kind: str) -> None:
    def actions(planner: Planner) -> list[float]:
        return [float(planner.command([1.0, 0.0])[0]) for _ in range(4)]

    planner = integrator_planner(kind, seed=3, samples=16)
    first = actions(planner)
    assert actions(integrator_planner(kind, seed=3, samples=16)) == first
    planner.reset()
    assert actions(planner) == first
    planner.reset(seed=4)
    assert actions(planner) != first


def test_an_action_is_held_and_planned_anew_after_that() -> None:
    calls = []

    def counted(states, actions):
        calls.append(actions)
        return to_target(states, actions)

    planner = CEM(walk([-1.0, 0.0, 1.0]), counted, horizon=6, hold=3, samples=20, iterations=2)
    held = [planner.command([0.0]) for _ in range(3)]
    assert held == [2, 2, 2]
    assert len(calls) == 2
    assert all((np.ptp(each.reshape(-1, 2, 3), axis=2) == 0).all() for each in calls)
    assert planner.command([3.0]) == 1
    assert len(calls) == 4


def test_continuous_actions_stay_in_the_bounds_that_are_given() -> None:
    def far_away(states, _):
        return -states[..., 0]

    for planner in (
        CEM(double_integrator(), far_away, horizon=3, samples=30, bounds=(-0.5, [0.25])),
        MPPI(double_integrator(), far_away, horizon=3, temperature=1e-3, samples=30, bounds=(-0.5, [0.25])),
    ):
        for _ in range(5):
            push = planner.command([0.0, 0.0])
            assert (push.shape, push.dtype) == ((1,), np.float32)
            assert -0.5 <= push[0] <= 0.25
        assert push[0] > 0.2


def test_a_model_of_two_frames_is_given_what_was_observed_and_what_was_commanded() -> None:
    planner = CEM(delayed_walk(), to_target, horizon=4, samples=100)
    assert planner.missing == 1
    with pytest.raises(
        PlanningError, match=r"2 frames, and 1 before this one are missing: call observe\(state, action\)"
    ):
        planner.command([0.0])
    planner.observe([0.0], 2)
    assert (planner.missing, planner.command([0.0])) == (0, 2)
    np.testing.assert_allclose(planner.plan.states[:, 0], [1.0, 2.0, 3.0, 3.0], atol=1e-5)
    planner.command([1.0])
    assert planner.plan.states[0, 0] == pytest.approx(2.0)  # by the command before
    kept = planner.plan
    other = CEM(delayed_walk(), to_target, horizon=4, samples=100)
    other.command([[0.0], [1.0]], [2])
    np.testing.assert_allclose(other.plan.states, kept.states, atol=1e-5)
    with pytest.raises(PlanningError, match=r"states should have shape \(2, 1\), but shape \(1, 1\) was given"):
        other.command([[0.0]], [2])


def test_exogenous_inputs_of_the_steps_ahead_are_planned_with() -> None:
    wind = Dimension("wind", "m/s", -np.inf, np.inf)
    push = ContinuousAction((Dimension("push", "m", -1.0, 1.0),))
    model = linear_simulator(np.array([[1.0], [1.0], [1.0]]), push, exogenous=[wind])
    planner = CEM(model, lambda states, _: np.square(states[..., 0]), horizon=2, samples=100, iterations=8)
    assert planner.command([0.0], exogenous=[[0.5], [-0.5]]) == pytest.approx(-0.5, abs=0.02)
    assert planner.plan.actions[1] == pytest.approx(0.5, abs=0.02)
    with pytest.raises(PlanningError, match=r"exogenous inputs \(wind\): give exogenous= of shape \(2, 1\)"):
        planner.command([0.0])
    with pytest.raises(PlanningError, match="no exogenous inputs; leave exogenous= out"):
        CEM(walk([0.0, 1.0]), to_target, horizon=2).command([0.0], exogenous=[[1.0]])


def test_a_plan_is_not_believed_where_trust_ends() -> None:
    model = trusted_model()[0]

    def far_away(states, _):
        return np.maximum(0.0, 40.0 - states[..., 0])

    free = CEM(model, far_away, horizon=5, samples=60)
    wary = CEM(model, far_away, horizon=5, samples=60, trust=0.05, penalty=1000.0)
    assert wary.trusts
    free.command([0.0, 0.0])
    wary.command([0.0, 0.0])
    assert free.plan.believed == wary.plan.believed == 5
    known = model.rollout([0.0, 0.0], wary.plan.actions, with_trust=True)
    assert (known.trust >= 0.05).all()
    # From far away nothing can be trusted: every step has the penalty, whatever it costs.
    wary.reset()
    wary.command([30.0, -30.0])
    assert (wary.plan.believed, wary.plan.cost) == (0, 5000.0)
    whole = CEM(model, lambda states, _: states[:, -1, 0], horizon=5, samples=60, trust=0.05, penalty=1000.0)
    whole.command([30.0, -30.0])
    assert whole.plan.cost == pytest.approx(5000.0 + whole.plan.states[-1, 0])


def test_trust_turns_a_plan_away_from_where_nothing_is_known() -> None:
    model = trusted_model()[0]

    def out(states, _):
        return -np.abs(states[..., 0] - states[..., 1]) - np.abs(states[..., 0])

    start = [3.0, 3.0]
    free, wary = (CEM(model, out, horizon=8, samples=100, **doubt) for doubt in ({}, {"trust": 0.02, "penalty": 10.0}))
    free.command(start)
    wary.command(start)
    trusts = [np.asarray(model.rollout(start, each.plan.actions, with_trust=True).trust) for each in (free, wary)]
    assert (trusts[0] < 0.02).any()
    assert wary.plan.believed > int(np.argmax(trusts[0] < 0.02))


def test_without_calibration_a_warning_says_so_and_plans_are_believed() -> None:
    with pytest.warns(UserWarning, match="believed to their end: nobody calibrated how far this") as caught:
        planner = CEM(walk([-1.0, 1.0]), to_target, horizon=3, samples=20, trust=0.1, penalty=5.0)
    assert not planner.trusts
    assert [each.filename for each in caught] == [__file__]
    planner.command([0.0])
    assert planner.plan.believed == 3
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        CEM(trusted_model()[0], quadratic, horizon=3, trust=0.1, penalty=5.0)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20), st.floats(0.01, 100.0))
def test_path_weights_are_shares_that_fall_with_the_cost(costs, temperature: float) -> None:
    weights = path_weights(np.array([*costs, np.inf]), temperature)
    assert weights.sum() == pytest.approx(1.0)
    assert weights[-1] == 0.0
    order = np.argsort(costs, kind="stable")
    assert (np.diff(weights[:-1][order]) <= 0.0).all()
    np.testing.assert_allclose(weights[:-1], path_weights(np.array(costs) + 7.0, temperature), atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"horizon": 0}, "horizon should be a whole number of at least 1, but is 0"),
        ({"horizon": 2.5}, "horizon should be a whole number of at least 1, but is 2.5"),
        ({"samples": 0}, "samples should be a whole number"),
        ({"hold": 3}, "the horizon should be a multiple of hold, 3 steps, but is 4"),
        ({"elites": 300}, "elites should be at most as many as the samples, 200, but are 300"),
        ({"elites": 0}, "elites should be a whole number of at least 1, but is 0"),
        ({"seed": -1}, "seed should be a whole number of at least 0, but is -1"),
        ({"smoothing": 0.0}, "smoothing should be above 0"),
        ({"bounds": (0, 1)}, "discrete actions have no bounds"),
        ({"trust": 1.5, "penalty": 1.0}, "trust should be a share above 0 and at most 1"),
        ({"penalty": 1.0}, "trust should be a share"),
        ({"trust": 0.5}, "penalty should be what a step costs that is not believed"),
    ],
)
def test_settings_that_no_planner_has_are_refused(changes, message: str) -> None:
    with pytest.raises(PlanningError, match=message):
        CEM(walk([-1.0, 1.0]), to_target, **{"horizon": 4, **changes})


@pytest.mark.parametrize(
    ("cost", "message"),
    [
        (
            lambda states, _: states,
            r"shape \(10,\), one number a plan, or \(10, 4\), one a step, but returned \(10, 4, 1\)",
        ),
        (lambda *_: 1.0, r"but returned \(\)"),
        (lambda *_: "dear", "should return an array of numbers, but returned str"),
        (lambda states, _: np.where(states[..., 0] > 0, np.nan, 1.0), r"should be finite, but nan was returned at \["),
        (lambda states, _: np.full(len(states), -np.inf), r"but -inf was returned at \[0\]"),
    ],
)
def test_a_cost_that_is_none_is_refused(cost, message: str) -> None:
    planner = CEM(walk([-1.0, 1.0]), cost, horizon=4, samples=10, iterations=1)
    with pytest.raises(PlanningError, match=message):
        planner.command([0.0])


def test_states_of_another_shape_are_refused() -> None:
    planner = CEM(walk([-1.0, 1.0]), to_target, horizon=4, samples=10)
    with pytest.raises(PlanningError, match=r"the state should have shape \(1,\), but shape \(2,\) was given"):
        planner.command([0.0, 1.0])
    with pytest.raises(ModelError, match="the state should be finite"):
        planner.command([np.nan])
    with pytest.raises(PlanningError, match=r"actions should be integers in 0..1 of shape \(\), but are 2"):
        planner.observe([0.0], 2)


def test_continuous_actions_need_bounds_and_discrete_ones_the_cross_entropy_method() -> None:
    unbounded = double_integrator(-np.inf, float(np.finfo(np.float32).max))
    for make in (CEM, lambda *given, **more: MPPI(*given, temperature=1.0, **more)):
        with pytest.raises(PlanningError, match=r"lie \(push\); give bounds=\(low, high\)"):
            make(unbounded, quadratic, horizon=3)
        make(unbounded, quadratic, horizon=3, bounds=(-1, 1))
        with pytest.raises(PlanningError, match="'push' should have a low bound below its high one: 1, 1"):
            make(unbounded, quadratic, horizon=3, bounds=(1, 1))
        with pytest.raises(PlanningError, match="bounds should be"):
            make(unbounded, quadratic, horizon=3, bounds=(-1, [1, 2]))
    with pytest.raises(
        PlanningError, match="MPPI is for continuous actions, but the model has 2 discrete ones; use CEM"
    ):
        MPPI(walk([0.0, 1.0]), to_target, horizon=3, temperature=1.0)
    with pytest.raises(PlanningError, match="temperature should be a finite number above 0"):
        MPPI(double_integrator(), quadratic, horizon=3, temperature=0.0)


def test_plans_whose_states_do_not_stay_finite_are_never_chosen() -> None:
    def explode(gain: float):
        push = ContinuousAction((Dimension("push", "m", -1.0, 1.0),))
        return linear_simulator(np.array([[0.0], [gain]]), push)

    seen = []

    def cost(states, _):
        seen.append(np.isfinite(states).all())
        return -np.abs(states[..., 0])

    planner = CEM(explode(3e38 * 1.1), cost, horizon=2, samples=50, iterations=2)
    planner.command([0.0])
    assert all(seen)
    assert np.isfinite(planner.plan.cost)


def test_a_model_that_leaves_all_bounds_under_every_plan_is_said_to() -> None:
    runaway = linear_simulator(np.array([[3e38], [0.0]]), ContinuousAction((Dimension("push", "m", -1.0, 1.0),)))
    with pytest.raises(PlanningError, match="under none of 20 plans the model's states stay finite over 3 steps"):
        CEM(runaway, lambda states, _: states[..., 0], horizon=3, samples=20).command([2.0])


def test_the_time_step_of_these_models_is_that_of_the_equations() -> None:
    found = double_integrator().predict([0.5, -1.0], [2.0])
    np.testing.assert_allclose(found, A @ [0.5, -1.0] + B @ [2.0], rtol=1e-6)
    assert STEP == 0.1
