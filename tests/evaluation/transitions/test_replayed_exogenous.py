"""Exogenous inputs in the evaluation: one step ahead and in rollouts a model is given those that were recorded."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from acrobot_recordings import acrobot_spaces
from learning import sail, untrained_model

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.evaluation.transitions.candidates import predictor_of
from addressed_dynamics.evaluation.transitions.one_step import predict_all
from addressed_dynamics.evaluation.transitions.physics import check_recording
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.rollouts import free_run
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, replay_recorded, true_rollouts
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts

WORLD = sail((40, 30))
HISTORIES = (1, 3)


def replay(history: int) -> TrueRollouts:
    params = RecordedRollouts(kind="recorded", episodes=4, steps=9, seed=0)
    return replay_recorded(params, WORLD, history, dict.fromkeys(range(2), "alone"))


@pytest.mark.parametrize("history", HISTORIES)
def test_one_step_ahead_every_frame_has_the_value_of_its_own_step(history: int) -> None:
    model = untrained_model(WORLD, history=history)
    points = Points.of(WORLD, model.features)
    every = torch.arange(len(points))
    rows = points.rows[:, None] + np.arange(1 - history, 1)
    wind = WORLD.exogenous[rows]
    wind = wind[:, 0] if history == 1 else wind
    np.testing.assert_array_equal(points.exogenous_inputs(every), wind)
    np.testing.assert_array_equal(points.exogenous, WORLD.exogenous[points.rows])
    expected = model.predict(*points.inputs(every), exogenous=torch.from_numpy(wind))
    torch.testing.assert_close(predict_all(predictor_of(model, "argmax"), points), expected, rtol=0.0, atol=0.0)


@pytest.mark.parametrize("history", HISTORIES)
def test_a_stretch_has_the_recorded_values_of_its_history_and_its_steps(history: int) -> None:
    truth = replay(history)
    assert truth.exogenous is not None
    assert truth.exogenous.shape == (4, history - 1 + 9, 1)
    for actions, before, wind in zip(truth.actions, truth.history_actions, truth.exogenous, strict=True):
        start = next(row for row in range(len(WORLD)) if (WORLD.action[row : row + 9] == actions).all())
        np.testing.assert_array_equal(before, WORLD.action[start - history + 1 : start])
        np.testing.assert_array_equal(wind, WORLD.exogenous[start - history + 1 : start + 9])
    chosen = truth.select([2, 0])
    np.testing.assert_array_equal(chosen.exogenous, truth.exogenous[[2, 0]])


@pytest.mark.parametrize("history", HISTORIES)
def test_a_rollout_depends_on_the_values_that_are_replayed(history: int) -> None:
    model, truth = untrained_model(WORLD, history=history), replay(history)
    assert truth.exogenous is not None
    frames = truth.history_states.astype(np.float32)
    actions = np.concatenate([truth.history_actions, truth.actions], axis=1)
    first = frames[:, 0] if history == 1 else frames
    predicted = free_run(model, truth, "argmax")
    np.testing.assert_array_equal(predicted, model.rollout(first, actions, "argmax", exogenous=truth.exogenous))
    shifted = free_run(model, replace(truth, exogenous=np.roll(truth.exogenous, 1, axis=1)), "argmax")
    assert (predicted != shifted).any(axis=(1, 2)).all()


def test_without_exogenous_inputs_there_are_none_to_replay() -> None:
    calm = replace(WORLD, spec=replace(WORLD.spec, exogenous=()), exogenous=np.empty((len(WORLD), 0), np.float32))
    params = RecordedRollouts(kind="recorded", episodes=4, steps=9, seed=0)
    assert replay_recorded(params, calm, 1, dict.fromkeys(range(2), "alone")).exogenous is None


def test_rollouts_beside_an_environment_are_refused_because_it_does_not_tell_them() -> None:
    environment = EnvironmentParams(id="addressed_dynamics/MountainCarContinuing-v0", kwargs={})
    params = EnvironmentRollouts(kind="environment", environment=environment, episodes=2, steps=5)
    with pytest.raises(EvaluationError, match=r"^[^\n]*exogenous inputs \(wind\) .* with 'kind: recorded'$"):
        true_rollouts(params, WORLD, 1, {})


def test_the_physics_of_acrobot_know_no_exogenous_inputs() -> None:
    windy = replace(acrobot_spaces(), exogenous=WORLD.spec.exogenous)
    with pytest.raises(EvaluationError, match="know no exogenous inputs, but the recording has wind; leave 'physics'"):
        check_recording(replay(1), windy)
