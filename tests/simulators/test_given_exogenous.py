"""Models with exogenous inputs: given beside the actions, step by step, and asked for exactly if there are any."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import drive, sail, untrained_model

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.networks.files import SavedNetwork, load_network, save_network
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.portable import StepModule

WORLD = sail((40, 30))
MODELS = {history: untrained_model(WORLD, history=history) for history in (1, 3)}
BATCH, STEPS = 5, 6


def given(history: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """First states, actions and winds of some rollouts; without a history, of one frame."""
    rows = np.arange(BATCH)[:, None] + np.arange(history - 1 + STEPS)
    states = WORLD.observation[rows[:, :history]]
    return states[:, 0] if history == 1 else states, WORLD.action[rows], WORLD.exogenous[rows]


@pytest.mark.parametrize("history", MODELS)
def test_a_rollout_is_given_in_every_step_what_stands_beside_its_action(history: int) -> None:
    model, (state, actions, wind) = MODELS[history], given(history)
    rolled = model.rollout(state, actions, exogenous=wind)
    for step in range(STEPS):
        rows = step if history == 1 else slice(step, step + history)
        after = model.predict(state, actions[:, rows], exogenous=wind[:, rows])
        np.testing.assert_array_equal(rolled[:, step], after)
        state = after if history == 1 else np.concatenate([state[:, 1:], after[:, None]], axis=1)


@pytest.mark.parametrize("history", MODELS)
def test_a_wind_that_comes_a_step_later_changes_a_rollout_from_where_it_differs(history: int) -> None:
    model, (state, actions, wind) = MODELS[history], given(history)
    changed = wind.copy()
    changed[:, history - 1 + 3] += 1.0
    first, other = (model.rollout(state, actions, "mixture", exogenous=each) for each in (wind, changed))
    np.testing.assert_array_equal(first[:, :3], other[:, :3])
    assert (first[:, 3:] != other[:, 3:]).any(axis=2).all()
    shifted = model.rollout(state, actions, "mixture", exogenous=np.roll(wind, 1, axis=1))
    assert (first != shifted).any()


@pytest.mark.parametrize("history", MODELS)
def test_one_sample_tensors_and_lists_say_the_same(history: int) -> None:
    model, (state, actions, wind) = MODELS[history], given(history)
    rolled = model.rollout(state, actions, exogenous=wind)
    np.testing.assert_allclose(model.rollout(state[1], actions[1], exogenous=wind[1].tolist()), rolled[1], rtol=1e-5)
    tensors = model.rollout(*(torch.from_numpy(each) for each in (state, actions)), exogenous=torch.from_numpy(wind))
    np.testing.assert_array_equal(tensors.numpy(), rolled)


def test_all_that_is_asked_of_a_model_depends_on_them() -> None:
    model, (state, actions, wind) = MODELS[1], given(1)
    action, wind = actions[:, 0], wind[:, 0]
    for method in (model.member_outputs, model.member_predictions, model.probabilities):
        assert (method(state, action, exogenous=wind) != method(state, action, exogenous=-wind)).any()
    expected = model.probabilities(state, action, exogenous=wind).argmax(axis=1)
    np.testing.assert_array_equal(model.address(state, action, exogenous=wind), expected)


@pytest.mark.parametrize(
    ("exogenous", "problem"),
    [
        (None, r"has exogenous inputs \(wind\), .* was given none; pass exogenous=, of shape \(5, 1\)"),
        (np.zeros(5), r"exogenous inputs \(wind\) should have shape \(5, 1\), but have \(5,\)"),
        (np.zeros((5, 2)), r"should have shape \(5, 1\), but have \(5, 2\)"),
        (np.zeros((4, 1)), r"should have shape \(5, 1\), but have \(4, 1\)"),
        (np.full((5, 1), np.nan), r"exogenous inputs should be finite .*\[0, 0\] is nan"),
    ],
)
def test_what_does_not_fit_the_exogenous_inputs_of_a_model_is_refused_in_one_line(exogenous: Any, problem: str) -> None:
    state, actions, _ = given(1)
    with pytest.raises(ModelError, match=rf"^[^\n]*{problem}[^\n]*$"):
        MODELS[1].predict(state, actions[:, 0], exogenous=exogenous)


@pytest.mark.parametrize("history", MODELS)
def test_a_rollout_needs_them_for_every_action(history: int) -> None:
    state, actions, wind = given(history)
    length = history - 1 + STEPS
    with pytest.raises(ModelError, match=rf"should have shape \(5, {length}, 1\), but have \(5, {length - 1}, 1\)"):
        MODELS[history].rollout(state, actions, exogenous=wind[:, 1:])
    with pytest.raises(ModelError, match=rf"pass exogenous=, of shape \(5, {length}, 1\)"):
        MODELS[history].rollout(state, actions)


def test_a_model_without_exogenous_inputs_is_given_none() -> None:
    car = drive()
    model = untrained_model(car)
    with pytest.raises(ModelError, match=r"has no exogenous inputs, but was given some of shape \(3, 1\)"):
        model.predict(car.observation[:3], car.action[:3], exogenous=np.zeros((3, 1)))
    with pytest.raises(ModelError, match=r"has no exogenous inputs, but was given some of shape \(1, 4, 1\)"):
        model.rollout(car.observation[:1], car.action[None, :4], exogenous=np.zeros((1, 4, 1)))


def test_a_model_says_what_they_are() -> None:
    assert "actions thrust; exogenous wind; 0.1 s a step" in repr(MODELS[1])
    assert "exogenous" not in repr(untrained_model(drive()))


@pytest.mark.parametrize("history", MODELS)
def test_the_portable_form_takes_them_behind_the_actions(history: int) -> None:
    model, (state, actions, wind) = MODELS[history], given(history)
    rows = 0 if history == 1 else slice(0, history)
    expected = model.predict(state, actions[:, rows], exogenous=wind[:, rows])
    inputs = [torch.from_numpy(each) for each in (state, actions[:, rows], wind[:, rows])]
    np.testing.assert_allclose(StepModule(model)(*inputs), expected, rtol=1e-5, atol=1e-6)


def test_a_saved_model_asks_for_them_again(tmp_path: Path) -> None:
    model, (state, actions, wind) = MODELS[1], given(1)
    for name, stack in {"ensemble": model.ensemble, "addressing": model.addressing}.items():
        assert stack is not None
        save_network(tmp_path / name, SavedNetwork(stack, model.features, {}))
    ensemble, addressing = (load_network(tmp_path / name, FeatureSpec) for name in ("ensemble", "addressing"))
    loaded = AddressedDynamics(ensemble.features, ensemble.stack, addressing.stack)
    np.testing.assert_array_equal(
        loaded.rollout(state, actions, exogenous=wind), model.rollout(state, actions, exogenous=wind)
    )
    with pytest.raises(ModelError, match=r"exogenous inputs \(wind\)"):
        loaded.rollout(state, actions)
