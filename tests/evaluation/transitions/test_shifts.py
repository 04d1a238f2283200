"""Shifts: transitions under other starts, behaviours and mechanics, as a log of them would be read."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from builders import CAR, WINDY, assert_same
from learning import drive

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.params.recording import RecordParams
from addressed_dynamics.envs import CONTINUING_MOUNTAIN_CAR, mountain_car_step
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.shifts import record_shift, record_shifts
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.recording.environments import make_environment
from addressed_dynamics.recording.plan import record_plan
from addressed_dynamics.recording.spaces import space_spec
from addressed_dynamics.sources.transitions.params import EvaluationParams, FeatureParams, ShiftParams
from addressed_dynamics.sources.transitions.reading import read_transitions

RANDOM = {"kind": "random", "mean_hold_steps": 4.0}
CART_POLE, ACROBOT, PENDULUM = (
    {"id": name} for name in ("CartPole-v1", "addressed_dynamics/Acrobot-v0", "Pendulum-v1")
)


def car(**kwargs: Any) -> dict[str, Any]:
    return {"id": CONTINUING_MOUNTAIN_CAR, "kwargs": kwargs}


def shift(**changes: Any) -> ShiftParams:
    section = {"name": "other", "kind": "starts", "environment": car(), "behaviour": RANDOM, "episodes": 3, "steps": 20}
    return ShiftParams.model_validate_json(json.dumps(section | changes))


def test_an_episode_is_what_the_recorder_writes_of_the_same_environment_and_behaviour(tmp_path: Path) -> None:
    for environment in (car(start_position=[-1.2, 0.6]), PENDULUM):
        recorded = {"environment": environment, "behaviour": RANDOM, "seed": 5}
        segment = {"name": "only", "environments": 1, "transitions": 30, **recorded}
        folder = tmp_path / environment["id"].replace("/", "-")
        folder.mkdir()
        plan = RecordParams.model_validate_json(json.dumps({"segments": [segment]}))
        record_plan(plan, folder, progress=lambda _: None)
        expected = read_transitions(folder)
        assert_same(record_shift(shift(**recorded, episodes=1, steps=30), expected.spec), expected)


def test_every_shift_is_under_its_name_with_its_episodes_and_repeats() -> None:
    params = EvaluationParams.model_validate_json(
        json.dumps(
            {
                "shifts": {
                    "walls": {"kind": "starts", "environment": car(start_position=[0.5, 0.6]), "behaviour": RANDOM},
                    "right": {
                        "kind": "behaviour",
                        "environment": car(),
                        "behaviour": {"kind": "constant", "action": 2},
                        "episodes": 2,
                        "steps": 7,
                    },
                }
            }
        )
    )
    found, again = record_shifts(params.shifts, CAR), record_shifts(params.shifts, CAR)
    assert list(found) == ["walls", "right"]
    for name, each in found.items():
        assert_same(each, again[name])
    walls, right = found.values()
    assert (len(walls), len(right)) == (40 * 100, 2 * 7)
    assert walls.observation[::100, 0].min() >= 0.5
    assert len(np.unique(walls.observation[::100, 0])) == 40, "every episode has a start of its own"
    assert right.episode.tolist() == [0] * 7 + [1] * 7
    assert right.step.tolist() == [*range(7)] * 2
    assert right.truncated.tolist() == ([False] * 6 + [True]) * 2
    assert set(right.action.tolist()) == {2}


def test_changed_mechanics_move_the_car_by_the_changed_equations() -> None:
    changed = record_shift(shift(kind="mechanics", environment=car(force=0.002, gravity=0.004)), CAR)
    state = changed.observation.astype(np.float64)
    after = mountain_car_step(state, changed.action, force=0.002, gravity=0.004)
    np.testing.assert_allclose(changed.next_observation, after, rtol=0, atol=1e-6)
    assert np.abs(changed.next_observation - mountain_car_step(state, changed.action)).max() > 1e-3


def test_an_episode_that_the_environment_ends_is_shorter_and_says_why() -> None:
    environment = {"id": "CartPole-v1"}
    spaces = space_spec(make_environment(shift(environment=environment).environment))
    found = record_shift(shift(environment=environment, behaviour={"kind": "constant", "action": 0}, steps=200), spaces)
    ends = [rows.stop - 1 for rows in found.episode_slices()]
    assert len(ends) == 3
    assert all(found.step[end] < 15 for end in ends)
    assert found.terminated[ends].all()
    assert found.terminated.sum() == 3
    assert not found.truncated.any()


@pytest.mark.parametrize("history", [1, 6])
def test_a_model_sees_its_points_with_their_history(history: int) -> None:
    features = fit_features(drive((40, 40)), FeatureParams(history=history))
    points = Points.of(record_shift(shift(), features.spaces), features)
    assert len(points) == 3 * (20 - history + 1)
    assert points.x(features).shape == (len(points), features.inputs)
    assert torch.isfinite(points.x(features)).all()


@pytest.mark.parametrize(
    ("changes", "spaces", "what"),
    [
        ({"environment": CART_POLE}, CAR, "expected the observation position in -1.2..0.6 m, velocity in"),
        (
            {"environment": car()},
            WINDY,
            "expected the exogenous inputs wind in -20..20 m/s, slope in -inf..inf, found none",
        ),
        ({"environment": {"id": "NoCar-v0"}}, CAR, "the environment 'NoCar-v0' cannot be made"),
        ({"environment": car(gravity=-1.0)}, CAR, "gravity should be a number in"),
        (
            {"behaviour": {"kind": "constant", "action": 3}},
            CAR,
            r"expected a constant action in Discrete\(3\), found 3",
        ),
        (
            {"behaviour": {"kind": "sign", "dimension": "speed", "negative": 0, "positive": 2}},
            CAR,
            "expected 'dimension' to be one of position, velocity, found 'speed'",
        ),
    ],
)
def test_what_cannot_be_recorded_is_one_line_with_the_name_of_the_shift(
    changes: dict[str, Any], spaces: Any, what: str
) -> None:
    with pytest.raises(EvaluationError, match=rf"^evaluation\.shifts\.other: [^\n]*{what}[^\n]*$"):
        record_shifts([shift(**changes)], spaces)


def test_a_step_of_another_length_is_another_world() -> None:
    slow = space_spec(make_environment(shift(environment=ACROBOT | {"kwargs": {"time_step": 0.05}}).environment))
    with pytest.raises(EvaluationError, match=r"expected the step 0\.05 s, found 0\.02 s"):
        record_shift(shift(environment=ACROBOT), slow)
