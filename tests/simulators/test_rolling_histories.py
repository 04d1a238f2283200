"""Models that are given several frames: the front door's shapes, and which action belongs to which frame."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from acrobot_recordings import acrobot_recording
from learning import swing, untrained_model

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.base.files import write_json
from addressed_dynamics.episodes.transitions import Transitions
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.modes import MODES, Mode
from addressed_dynamics.simulators.portable import StepModule
from addressed_dynamics.sources.transitions.params import FeatureParams

HISTORY, STEPS, BATCH = 4, 5, 3
ANGLES = [
    {"name": f"angle_{i}", "cosine": f"cos_angle_{i}", "sine": f"sin_angle_{i}", "velocity": f"velocity_{i}"}
    for i in (1, 2)
]
ROUNDING = 3e-5
"""What the last digit of an angle is worth as a velocity over 0.02 s, in rad/s."""
SURE: tuple[Mode, ...] = ("argmax", "mixture", "blend")


def acrobot_model(world: Transitions, *, members: int = 3, **features: Any) -> AddressedDynamics:
    """A model as the paper's of Acrobot, but small and untrained: angles, and a head for each member."""
    settings = {"target": "change", "history": HISTORY, "angles": ANGLES, "velocity": "difference", **features}
    spec = fit_features(world, FeatureParams.model_validate(settings, strict=False))
    generator = torch.Generator().manual_seed(0)
    ensemble = StackedMLP(members, (spec.inputs, 16, 8, spec.outputs), "tanh", generator)
    addressing = StackedMLP(members, (spec.inputs, 12, 8, 1), "tanh", generator, shared=1)
    return AddressedDynamics(spec, ensemble.requires_grad_(False), addressing.requires_grad_(False))


ACROBOT, ARM = acrobot_recording([40, 40]), swing((40, 40))
MODELS = {
    "acrobot": (ACROBOT, acrobot_model(ACROBOT)),
    "acrobot, velocities predicted": (ACROBOT, acrobot_model(ACROBOT, velocity="predicted", history_weight=0.3)),
    "arm": (ARM, untrained_model(ARM, history=HISTORY)),
}
cases = pytest.mark.parametrize(("world", "model"), MODELS.values(), ids=MODELS)


def stretches(world: Transitions, length: int) -> tuple[np.ndarray, np.ndarray]:
    """States (B, length, d) and actions (B, length, ...) of three stretches of an episode."""
    rows = np.arange(BATCH)[:, None] * 9 + np.arange(length)
    return world.observation[rows], world.action[rows]


def other_action(action: np.ndarray) -> np.ndarray:
    changed: np.ndarray = (action + 1) % 3 if np.issubdtype(action.dtype, np.integer) else action + 1.0
    return changed


def without_addressing(model: AddressedDynamics, frames: np.ndarray, actions: np.ndarray, mode: Mode) -> np.ndarray:
    """Predict from the networks themselves, one sample after the other."""
    features, rows = model.features, []
    weights = np.append(np.full(HISTORY - 1, features.history_weight), 1.0)
    weights /= np.sqrt(np.mean(weights**2))
    for states, acted in zip(torch.from_numpy(frames), torch.from_numpy(actions), strict=True):
        kind = features.spaces.action
        encoded = torch.eye(len(kind.names))[acted] if hasattr(kind, "names") else acted
        each = (torch.cat([states, encoded], dim=1) - torch.tensor(features.input_mean)) / torch.tensor(
            features.input_deviation
        )
        x = (each * torch.tensor(weights, dtype=torch.float32)[:, None]).reshape(1, -1)
        assert model.addressing is not None
        scores = model.addressing(x)
        probability = torch.softmax(scores.flatten(), dim=0)
        if mode == "argmax":
            output = model.ensemble(x)[probability.argmax()]
        elif mode == "mixture":
            output = torch.einsum("m,mso->so", probability, model.ensemble(x))
        else:
            output = model.ensemble.forward_blended(x, probability[None])
        rows.append(features.decode(output, states[-1:])[0])
    return torch.stack(rows).numpy()


@cases
@pytest.mark.parametrize("mode", SURE)
def test_a_prediction_follows_the_last_of_the_frames(world: Transitions, model: AddressedDynamics, mode: Mode) -> None:
    frames, actions = stretches(world, HISTORY)
    found = model.predict(frames, actions, mode)
    assert (found.shape, found.dtype) == ((BATCH, frames.shape[2]), np.float32)
    np.testing.assert_allclose(found, without_addressing(model, frames, actions, mode), rtol=1e-4, atol=1e-5)


@cases
@pytest.mark.parametrize("mode", MODES)
def test_a_rollout_is_a_repeated_prediction_from_the_frames_before(
    world: Transitions, model: AddressedDynamics, mode: Mode
) -> None:
    frames, actions = stretches(world, HISTORY - 1 + STEPS)
    generators = [torch.Generator().manual_seed(0) for _ in range(2)]
    rolled = model.rollout(frames[:, :HISTORY], actions, mode, generator=generators[0])
    assert (rolled.shape, rolled.dtype) == ((BATCH, STEPS, frames.shape[2]), np.float32)
    seen = list(np.moveaxis(frames[:, :HISTORY], 1, 0))
    for step in range(STEPS):
        window = np.stack(seen[-HISTORY:], axis=1)
        seen.append(model.predict(window, actions[:, step : step + HISTORY], mode, generator=generators[1]))
    np.testing.assert_array_equal(rolled, np.stack(seen[HISTORY:], axis=1))


@cases
@pytest.mark.parametrize("frame", range(HISTORY - 1 + STEPS))
def test_an_action_is_taken_in_its_frame(world: Transitions, model: AddressedDynamics, frame: int) -> None:
    frames, actions = stretches(world, HISTORY - 1 + STEPS)
    first = frames[:, :HISTORY]
    changed = actions.copy()
    changed[:, frame] = other_action(changed[:, frame])
    rolled, other = model.rollout(first, actions, "mixture"), model.rollout(first, changed, "mixture")
    differs = [bool((rolled[:, step] != other[:, step]).all(axis=0).any()) for step in range(STEPS)]
    untouched = max(frame - HISTORY + 1, 0)
    assert differs == [False] * untouched + [True] * (STEPS - untouched)
    np.testing.assert_array_equal(rolled[:, :untouched], other[:, :untouched])


@cases
def test_the_order_of_the_frames_matters(world: Transitions, model: AddressedDynamics) -> None:
    frames, actions = stretches(world, HISTORY)
    expected = model.predict(frames, actions, "mixture")
    older_swapped = frames[:, [1, 0, 2, 3]]
    assert (model.predict(older_swapped, actions[:, [1, 0, 2, 3]], "mixture") != expected).any()


@cases
@pytest.mark.parametrize("mode", MODES)
def test_arrays_give_arrays_and_tensors_give_tensors(world: Transitions, model: AddressedDynamics, mode: Mode) -> None:
    frames, actions = stretches(world, HISTORY)
    generators = [torch.Generator().manual_seed(0) for _ in range(4)]
    array = model.predict(frames, actions, mode, generator=generators[0])
    tensor = model.predict(torch.from_numpy(frames), torch.from_numpy(actions), mode, generator=generators[1])
    assert isinstance(array, np.ndarray)
    assert isinstance(tensor, torch.Tensor)
    np.testing.assert_array_equal(array, tensor)
    rolled = model.rollout(frames, actions, mode, generator=generators[2])
    rolled_tensor = model.rollout(torch.from_numpy(frames), torch.from_numpy(actions), mode, generator=generators[3])
    assert isinstance(rolled, np.ndarray)
    assert isinstance(rolled_tensor, torch.Tensor)
    np.testing.assert_array_equal(rolled, rolled_tensor)
    np.testing.assert_array_equal(rolled[:, 0], array)


@cases
def test_double_precision_is_understood_and_left_alone(world: Transitions, model: AddressedDynamics) -> None:
    frames, actions = stretches(world, HISTORY - 1 + STEPS)
    double = frames[:, :HISTORY].astype(np.float64)
    double.flags.writeable = False
    predicted = model.predict(double, actions[:, :HISTORY])
    assert predicted.dtype == np.float32
    np.testing.assert_array_equal(predicted, model.predict(frames[:, :HISTORY], actions[:, :HISTORY]))
    np.testing.assert_array_equal(model.rollout(double, actions), model.rollout(frames[:, :HISTORY], actions))


@cases
def test_rollouts_of_no_steps_and_predictions_of_no_samples_are_empty(
    world: Transitions, model: AddressedDynamics
) -> None:
    frames, actions = stretches(world, HISTORY)
    width = frames.shape[2]
    assert model.rollout(frames, actions[:, : HISTORY - 1]).shape == (BATCH, 0, width)
    assert model.rollout(frames[:0], actions[:0]).shape == (0, 1, width)
    assert model.predict(frames[:0], actions[:0]).shape == (0, width)


FRAMES = np.zeros((3, 4, 6))


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (FRAMES[:, 0], np.zeros(3, int), r"shape \(B, 4, 6\), but have \(3, 6\)"),
        (FRAMES[:, :3], np.zeros((3, 3), int), r"shape \(B, 4, 6\), but have \(3, 3, 6\)"),
        (FRAMES, np.zeros(3, int), r"integers of shape \(3, 4\)"),
        (FRAMES, np.zeros((3, 5), int), r"integers of shape \(3, 4\)"),
        (FRAMES, np.zeros((3, 4)), "float64 of shape"),
        (FRAMES, np.full((3, 4), 3), r"0\.\.2"),
    ],
)
def test_frames_and_actions_that_do_not_fit_a_prediction_are_refused(
    observation: np.ndarray, action: np.ndarray, message: str
) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        MODELS["acrobot"][1].predict(observation, action)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("observation", "actions", "message"),
    [
        (FRAMES, np.zeros((3, 2), int), r"actions should have shape \(3, 3 \+ T, ...\), but have \(3, 2\)"),
        (FRAMES, np.zeros((2, 8), int), r"actions should have shape \(3, 3 \+ T"),
        (FRAMES, np.zeros(8, int), r"actions should have shape \(3, 3 \+ T"),
        (FRAMES[:, 0], np.zeros((3, 8), int), r"shape \(B, 4, 6\), but have \(3, 6\)"),
        (FRAMES[:, 0], np.zeros((3, 3), int), r"shape \(B, 4, 6\), but have \(3, 6\)"),
        (FRAMES[:, :3], np.zeros((3, 8), int), r"shape \(B, 4, 6\), but have \(3, 3, 6\)"),
        (FRAMES[0], np.zeros((3, 8), int), r"shape \(B, 4, 6\), but have \(4, 6\)"),
        (np.float64(0.0), np.zeros((3, 8), int), r"shape \(B, 4, 6\), but have \(\)"),
        (FRAMES, np.zeros((3, 8, 1), int), r"integers of shape \(3, 4\)"),
        (FRAMES, np.full((3, 8), -1), r"0\.\.2"),
    ],
)
def test_frames_and_actions_that_do_not_fit_a_rollout_are_refused(
    observation: np.ndarray, actions: np.ndarray, message: str
) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        MODELS["acrobot"][1].rollout(observation, actions)
    assert "\n" not in str(caught.value)


@cases
def test_the_portable_form_predicts_what_the_model_does(world: Transitions, model: AddressedDynamics) -> None:
    frames, actions = stretches(world, HISTORY)
    with torch.no_grad():
        found = StepModule(model)(torch.from_numpy(frames), torch.from_numpy(actions))
    np.testing.assert_allclose(found, model.predict(frames, actions), rtol=1e-5, atol=ROUNDING)


def test_the_portable_form_of_one_network_needs_no_addressing() -> None:
    features = acrobot_model(ACROBOT).features
    alone = StackedMLP(1, (features.inputs, 8, features.outputs), "relu", torch.Generator().manual_seed(1))
    model = AddressedDynamics(features, alone.requires_grad_(False))
    frames, actions = stretches(ACROBOT, HISTORY)
    found = StepModule(model)(torch.from_numpy(frames), torch.from_numpy(actions))
    np.testing.assert_allclose(found, model.predict(frames, actions), rtol=1e-5, atol=ROUNDING)


def test_what_is_loaded_returns_whole_states_whatever_its_network_predicts_inside(tmp_path: Path) -> None:
    saved = MODELS["acrobot"][1]
    assert saved.addressing is not None
    save_network(tmp_path / "ensemble" / "seed-0", SavedNetwork(saved.ensemble, saved.features, {}))
    save_network(tmp_path / "addressing" / "seed-0" / "plain", SavedNetwork(saved.addressing, saved.features, {}))
    index = {"format": 1, "delivered": {"0": "plain"}, "variants": ["plain"]}
    write_json(tmp_path / "addressing" / "addressing.json", index)
    loaded = AddressedDynamics.load(tmp_path, seed=0)
    assert loaded.features.outputs == 4
    frames, actions = stretches(ACROBOT, HISTORY - 1 + STEPS)
    rolled = loaded.rollout(frames[:, :HISTORY], actions)
    assert rolled.shape == (BATCH, STEPS, 6)
    np.testing.assert_array_equal(rolled, saved.rollout(frames[:, :HISTORY], actions))
