import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import drive, swing, untrained_model

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.transitions import DiscreteAction, Transitions
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.delivery import Choice, Delivered, read_delivered, write_delivered
from addressed_dynamics.simulators.modes import MODES, Mode

WORLDS = {"car": drive((30, 20)), "arm": swing()}
HIDDEN = {"tanh": np.tanh, "relu": lambda x: np.maximum(x, 0.0)}


def layers(stack: StackedMLP) -> list[tuple[np.ndarray, np.ndarray]]:
    """Weights (member, in, out) and biases (member, out) in float64."""
    pairs = zip(stack.weights, stack.biases, strict=True)
    return [(weight.double().numpy(), bias.double().numpy()[:, 0]) for weight, bias in pairs]


def one_network(x: np.ndarray, parameters: list[tuple[np.ndarray, np.ndarray]], activation: str) -> np.ndarray:
    for index, (weight, bias) in enumerate(parameters):
        x = x @ weight + bias
        x = HIDDEN[activation](x) if index < len(parameters) - 1 else x
    return x


def naive(model: AddressedDynamics, observation: np.ndarray, action: np.ndarray, mode: str) -> np.ndarray:
    """Predict one sample after the other in float64: the oracle."""
    features, ensemble, addressing = model.features, model.ensemble, model.addressing
    assert addressing is not None
    discrete = isinstance(features.spaces.action, DiscreteAction)
    address, stacked = [(w[0], b[0]) for w, b in layers(addressing)], layers(ensemble)
    members = [[(w[m], b[m]) for w, b in stacked] for m in range(ensemble.members)]
    rows = []
    for state, act in zip(observation.astype(np.float64), action, strict=True):
        encoded = np.eye(features.spaces.action.count)[act] if discrete else act.astype(np.float64)
        x = (np.concatenate([state, encoded]) - features.input_mean) / features.input_deviation
        scores = one_network(x, address, addressing.activation)
        probability = np.exp(scores) / np.exp(scores).sum()
        outputs = np.array([one_network(x, member, ensemble.activation) for member in members])
        if mode == "argmax":
            output = outputs[probability.argmax()]
        elif mode == "mixture":
            output = probability @ outputs
        else:
            mixed = [(np.tensordot(probability, w, 1), np.tensordot(probability, b, 1)) for w, b in stacked]
            output = one_network(x, mixed, ensemble.activation)
        target = (output * features.target_deviation + features.target_mean) * features.scale
        rows.append(target + state if features.target == "change" else target)
    return np.array(rows)


def assert_near(found: np.ndarray, expected: np.ndarray, model: AddressedDynamics) -> None:
    scale = np.array(model.features.scale)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("mode", ["argmax", "mixture", "blend"])
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
@pytest.mark.parametrize("target", ["absolute", "change"])
def test_a_mode_gives_what_the_naive_formula_gives(mode: Mode, world: Transitions, target: str) -> None:
    model = untrained_model(world, target=target)
    predicted = model.predict(world.observation, world.action, mode)
    assert_near(predicted, naive(model, world.observation, world.action, mode), model)


def test_sampling_draws_each_member_as_often_as_its_probability_says() -> None:
    world = WORLDS["car"]
    model = untrained_model(world)
    observation = np.repeat(world.observation[:1], 20_000, axis=0)
    action = np.repeat(world.action[:1], 20_000)
    members = model.member_predictions(torch.from_numpy(observation[:1]), torch.from_numpy(action[:1]))[:, 0]
    drawn = model.predict(observation, action, "sample", generator=torch.Generator().manual_seed(0))
    member = (torch.from_numpy(drawn)[:, None] - members).abs().sum(dim=2).argmin(dim=1)
    torch.testing.assert_close(torch.from_numpy(drawn), members[member], rtol=1e-5, atol=1e-6)
    assert model.addressing is not None
    x = model.features.encode(torch.from_numpy(observation[:1]), torch.from_numpy(action[:1]))
    probability = torch.softmax(model.addressing(x)[0, 0], dim=0)
    shares = torch.bincount(member, minlength=3) / len(member)
    torch.testing.assert_close(shares, probability, rtol=0.0, atol=0.015)  # four standard errors


def test_sampling_follows_its_generator() -> None:
    world = WORLDS["car"]
    model = untrained_model(world)
    first, again, other = (
        model.predict(world.observation, world.action, "sample", generator=torch.Generator().manual_seed(seed))
        for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_arrays_give_arrays_and_tensors_give_tensors_with_the_same_numbers(mode: Mode, world: Transitions) -> None:
    model = untrained_model(world)
    observation, action = torch.from_numpy(world.observation), torch.from_numpy(world.action)
    generators = [torch.Generator().manual_seed(0) for _ in range(2)]
    array = model.predict(world.observation, world.action, mode, generator=generators[0])
    tensor = model.predict(observation, action, mode, generator=generators[1])
    assert isinstance(array, np.ndarray)
    assert isinstance(tensor, torch.Tensor)
    assert array.dtype == np.float32
    assert not tensor.requires_grad
    np.testing.assert_array_equal(array, tensor)


def test_arrays_of_any_layout_and_precision_are_understood_and_left_alone() -> None:
    world = WORLDS["car"]
    model = untrained_model(world)
    expected = model.predict(world.observation, world.action)
    double = np.asfortranarray(world.observation.astype(np.float64))
    double.flags.writeable = False
    np.testing.assert_array_equal(model.predict(double, world.action.astype(np.int32)), expected)
    backwards = model.predict(world.observation[::-1], world.action[::-1])
    np.testing.assert_allclose(backwards[::-1], expected, rtol=1e-5, atol=1e-7)
    backwards[:] = 0.0
    assert world.observation.any()


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_a_rollout_is_a_repeated_prediction(mode: Mode, world: Transitions) -> None:
    model = untrained_model(world)
    first, actions = world.observation[:3], world.action[:12].reshape(3, 4, *world.action.shape[1:])
    generators = [torch.Generator().manual_seed(0) for _ in range(2)]
    rolled = model.rollout(first, actions, mode, generator=generators[0])
    state, states = first, []
    for step in range(4):
        state = model.predict(state, actions[:, step], mode, generator=generators[1])
        states.append(state)
    assert rolled.dtype == np.float32
    np.testing.assert_array_equal(rolled, np.stack(states, axis=1))


def test_rollouts_of_no_steps_and_predictions_of_no_samples_are_empty() -> None:
    model = untrained_model(WORLDS["car"])
    assert model.rollout(np.zeros((3, 2), np.float32), np.zeros((3, 0), np.int64)).shape == (3, 0, 2)
    for mode in MODES:
        assert model.predict(np.zeros((0, 2), np.float32), np.zeros(0, np.int64), mode).shape == (0, 2)


@pytest.mark.parametrize("mode", MODES)
def test_a_model_of_one_member_needs_no_addressing(mode: Mode) -> None:
    world = WORLDS["car"]
    model = untrained_model(world, members=1)
    expected = model.member_predictions(torch.from_numpy(world.observation), torch.from_numpy(world.action))[0]
    np.testing.assert_allclose(model.predict(world.observation, world.action, mode), expected, rtol=1e-5, atol=1e-6)
    assert model.address(torch.from_numpy(world.observation), torch.from_numpy(world.action)).tolist() == [0] * 50


@pytest.mark.parametrize(
    ("observation", "action", "message"),
    [
        (np.zeros((3, 4)), np.zeros(3, int), r"shape \(B, 2\)"),
        (np.zeros(2), np.zeros(1, int), r"shape \(B, 2\)"),
        (np.zeros((3, 2)), np.zeros(2, int), "discrete actions should be integers"),
        (np.zeros((3, 2)), np.zeros(3), "discrete actions should be integers"),
        (np.zeros((3, 2)), np.array([0, 1, 3]), r"0\.\.2"),
    ],
)
def test_wrong_shapes_and_actions_are_refused(observation: np.ndarray, action: np.ndarray, message: str) -> None:
    model = untrained_model(WORLDS["car"])
    with pytest.raises(ModelError, match=message):
        model.predict(observation, action)


@pytest.mark.parametrize("actions", [np.zeros(3, int), np.zeros((2, 5), int)])
def test_actions_that_do_not_fit_a_rollout_are_refused(actions: np.ndarray) -> None:
    with pytest.raises(ModelError, match=r"actions should have shape \(3, T"):
        untrained_model(WORLDS["car"]).rollout(np.zeros((3, 2)), actions)


def test_a_mode_that_does_not_exist_is_refused() -> None:
    world = WORLDS["car"]
    with pytest.raises(ModelError, match="no addressing mode 'best'"):
        untrained_model(world).predict(world.observation, world.action, "best")  # type: ignore[call-overload] # that is the point


def test_networks_that_do_not_fit_are_refused() -> None:
    model = untrained_model(WORLDS["car"])
    with pytest.raises(ModelError, match="4 inputs to 2 outputs"):
        AddressedDynamics(model.features, StackedMLP(1, (4, 2), "relu"))
    with pytest.raises(ModelError, match="3 members needs an addressing network"):
        AddressedDynamics(model.features, model.ensemble)
    with pytest.raises(ModelError, match="should be one network with 5 inputs and 3 outputs"):
        AddressedDynamics(model.features, model.ensemble, StackedMLP(1, (5, 2), "relu"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A model folder with two seeds and two variants, all different."""
    folder = tmp_path_factory.mktemp("models") / "car"
    for seed in (4, 2):
        for number, variant in enumerate(("plain", "cost_sensitive")):
            model = untrained_model(WORLDS["car"], seed=seed)
            addressing = untrained_model(WORLDS["car"], seed=10 * seed + number).addressing
            assert addressing is not None
            save_network(folder / "ensemble" / f"seed-{seed}", SavedNetwork(model.ensemble, model.features, {}))
            save_network(folder / "addressing" / f"seed-{seed}" / variant, SavedNetwork(addressing, model.features, {}))
    index = {"format": 1, "delivered": {"4": "cost_sensitive", "2": "plain"}, "variants": ["plain", "cost_sensitive"]}
    (folder / "addressing" / "addressing.json").write_text(json.dumps(index))
    alone = StackedMLP(1, (5, 4, 2), "relu", torch.Generator().manual_seed(9)).requires_grad_(False)
    for name in ("relu_512/seed-3", "relu_512/seed-5", "pair/seed-3"):
        save_network(folder / "baselines" / name / "network", SavedNetwork(alone, model.features, {}))
    trained = {"format": 1, "trained": ["relu_512/seed-3", "relu_512/seed-5"], "pair": ["pair/seed-3"]}
    (folder / "baselines" / "baselines.json").write_text(json.dumps(trained))
    write_delivered(folder, Delivered(4, "cost_sensitive", "argmax"))
    return folder


def is_of(model: AddressedDynamics, seed: int, variant: str) -> bool:
    number = ["plain", "cost_sensitive"].index(variant)
    addressing = untrained_model(WORLDS["car"], seed=10 * seed + number).addressing
    assert addressing is not None
    assert model.addressing is not None
    ensemble = untrained_model(WORLDS["car"], seed=seed).ensemble
    return torch.equal(model.ensemble.weights[0], ensemble.weights[0]) and torch.equal(
        model.addressing.weights[0], addressing.weights[0]
    )


def test_what_is_delivered_is_loaded_unless_another_is_asked_for(folder: Path) -> None:
    assert is_of(AddressedDynamics.load(folder), 4, "cost_sensitive")
    assert is_of(AddressedDynamics.load(str(folder), seed=2), 2, "plain")
    assert is_of(AddressedDynamics.load(folder, variant="plain"), 4, "plain")
    assert is_of(AddressedDynamics.load(folder, seed=2, variant="cost_sensitive"), 2, "cost_sensitive")


def test_another_seed_and_variant_than_the_first_are_loaded_if_they_are_what_evaluation_delivered(
    folder: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    write_delivered(copy, Delivered(2, "cost_sensitive", "argmax"))
    assert is_of(AddressedDynamics.load(copy), 2, "cost_sensitive")


def test_a_delivered_model_predicts_and_rolls_out_in_the_mode_that_evaluation_delivered(
    folder: Path, tmp_path: Path
) -> None:
    copy, world = shutil.copytree(folder, tmp_path / "car"), WORLDS["car"]
    write_delivered(copy, Delivered(2, "plain", "mixture"))
    model, state, action = AddressedDynamics.load(copy), world.observation[:5], world.action[:5]
    assert model.mode == "mixture"
    np.testing.assert_array_equal(model.predict(state, action), model.predict(state, action, "mixture"))
    assert not np.array_equal(model.predict(state, action), model.predict(state, action, "argmax"))
    steps = np.stack([action, action], axis=1)
    np.testing.assert_array_equal(model.rollout(state, steps), model.rollout(state, steps, "mixture"))
    assert AddressedDynamics.load(copy, seed=2).mode == "argmax"


def test_what_is_recommended_is_loaded_by_that_name(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    with pytest.raises(ModelError, match=r"it recommends no model; 'dvc repro evaluate@car' does"):
        AddressedDynamics.load(copy, candidate="recommended")
    write_delivered(copy, Delivered(4, "plain", "argmax", Choice("relu_512", 5, None, "argmax")))
    single = AddressedDynamics.load(copy, candidate="recommended")
    assert (single.ensemble.members, str(single.origin)) == (1, "candidate relu_512, seed 5")
    assert is_of(AddressedDynamics.load(copy), 4, "plain")
    write_delivered(copy, Delivered(4, "plain", "argmax", Choice("ensemble", 2, "cost_sensitive", "mixture")))
    model = AddressedDynamics.load(copy, candidate="recommended")
    assert is_of(model, 2, "cost_sensitive")
    assert model.mode == "mixture"
    with pytest.raises(ModelError, match="what is recommended has a seed and a variant of its own"):
        AddressedDynamics.load(copy, candidate="recommended", seed=2)


def test_what_is_delivered_may_be_a_baseline_beside_which_the_ensemble_keeps_its_place(
    folder: Path, tmp_path: Path
) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    best = Choice("relu_512", 5, None, "argmax")
    delivered = Delivered(
        5, None, "argmax", best, "relu_512", Choice("ensemble", 2, "cost_sensitive", "argmax"), "best",
        {"relu_512/seed-5": {"one_step_percent": 1.0}, "ensemble/argmax": {"one_step_percent": 2.0}},
    )  # fmt: skip
    write_delivered(copy, delivered)
    assert read_delivered(copy) == delivered
    assert str(AddressedDynamics.load(copy).origin) == "candidate relu_512, seed 5"
    assert str(AddressedDynamics.load(copy, candidate="recommended").origin) == "candidate relu_512, seed 5"
    assert is_of(AddressedDynamics.load(copy, candidate="ensemble"), 2, "cost_sensitive")
    assert is_of(AddressedDynamics.load(copy, variant="plain"), 2, "plain")
    assert is_of(AddressedDynamics.load(copy, seed=4), 4, "cost_sensitive")


def test_what_an_earlier_version_delivered_is_an_ensemble(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    recommended = {"candidate": "relu_512", "seed": 5, "variant": None, "mode": "argmax"}
    old = {"format": 1, "seed": 2, "variant": "plain", "mode": "mixture", "recommended": recommended}
    (copy / "delivered.json").write_text(json.dumps(old))
    assert is_of(AddressedDynamics.load(copy), 2, "plain")
    assert AddressedDynamics.load(copy).mode == "mixture"
    assert read_delivered(copy) == Delivered(2, "plain", "mixture", Choice(**recommended))


def test_a_delivered_mode_that_does_not_exist_is_refused(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    write_delivered(copy, Delivered(2, "plain", "phase"))
    with pytest.raises(ModelError, match=r"no addressing mode 'phase' \(modes: argmax, "):
        AddressedDynamics.load(copy)


def test_any_other_model_that_was_trained_is_loaded_by_its_name(folder: Path) -> None:
    for seed in (None, 5):
        model = AddressedDynamics.load(folder, candidate="relu_512", seed=seed)
        assert (model.ensemble.members, model.ensemble.widths, model.addressing) == (1, (5, 4, 2), None)
    assert is_of(AddressedDynamics.load(folder, candidate="ensemble"), 4, "cost_sensitive")
    with pytest.raises(ModelError, match=r"no candidate 'relu' \(candidates there: ensemble, relu_512\)$"):
        AddressedDynamics.load(folder, candidate="relu")
    for name, asked in {"same_size": "same_size", "paper_recipe": "other_recipe"}.items():
        with pytest.raises(
            ModelError, match=rf"no candidate '{name}' .*; name it in baselines.train \('{asked}'\) and run"
        ):
            AddressedDynamics.load(folder, candidate=name)
    with pytest.raises(ModelError, match=r"no candidate 'last_change' .*; there is one if features.history is above 1"):
        AddressedDynamics.load(folder, candidate="last_change")
    with pytest.raises(ModelError, match=r"'relu_512' was not trained from seed 4 \(seeds there: 3, 5\)"):
        AddressedDynamics.load(folder, candidate="relu_512", seed=4)
    with pytest.raises(ModelError, match="'relu_512' has none"):
        AddressedDynamics.load(folder, candidate="relu_512", variant="plain")


@pytest.mark.parametrize("text", ['{"format": 1}', '{"format": 1, "trained": ["relu_512"]}', '{"trained": [3]}'])
def test_an_index_of_baselines_that_is_damaged_is_one_line(folder: Path, tmp_path: Path, text: str) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    (copy / "baselines" / "baselines.json").write_text(text)
    with pytest.raises(ModelError, match=r"incomplete or malformed .*; run train_baselines again"):
        AddressedDynamics.load(copy, candidate="relu_512")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (None, r"nobody knows which of the models is delivered; .*'dvc repro evaluate@car'"),
        ("{", "damaged"),
        ('{"format": 1, "seed": 4}', "incomplete or malformed"),
        ('{"format": 1, "seed": "x", "variant": null, "mode": "argmax"}', "incomplete or malformed"),
    ],
)
def test_a_folder_that_does_not_say_what_is_delivered_gives_no_model_of_its_own_choice(
    folder: Path, tmp_path: Path, text: str | None, said: str
) -> None:
    copy = shutil.copytree(folder, tmp_path / "car")
    (copy / "delivered.json").unlink()
    if text is not None:
        (copy / "delivered.json").write_text(text)
    with pytest.raises(ModelError, match=said):
        AddressedDynamics.load(copy)
    assert is_of(AddressedDynamics.load(copy, seed=2), 2, "plain")


def test_a_loaded_model_predicts_what_the_saved_one_predicted(folder: Path) -> None:
    world, loaded = WORLDS["car"], AddressedDynamics.load(folder)
    saved = AddressedDynamics(
        untrained_model(world, seed=4).features,
        untrained_model(world, seed=4).ensemble,
        untrained_model(world, seed=41).addressing,
    )
    np.testing.assert_array_equal(
        loaded.predict(world.observation, world.action), saved.predict(world.observation, world.action)
    )


def test_a_seed_or_variant_that_was_not_trained_is_refused_with_those_that_were(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"seed 7 was not trained \(seeds there: 4, 2\)"):
        AddressedDynamics.load(folder, seed=7)
    with pytest.raises(ModelError, match=r"no addressing variant 'best' \(variants there: plain, cost_sensitive\)"):
        AddressedDynamics.load(folder, variant="best")


def test_a_folder_that_is_missing_or_incomplete_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="no such model folder"):
        AddressedDynamics.load(tmp_path / "nowhere")
    (tmp_path / "addressing").mkdir()
    with pytest.raises(ModelError, match="not a whole model folder"):
        AddressedDynamics.load(tmp_path, seed=0)
    (tmp_path / "addressing" / "addressing.json").write_text('{"format": 1, "delivered": 3, "variants": []}')
    with pytest.raises(ModelError, match="incomplete or malformed"):
        AddressedDynamics.load(tmp_path, seed=0)


def test_lists_and_arrays_give_arrays_tensors_give_tensors_and_one_sample_gives_one() -> None:
    model = untrained_model(WORLDS["car"], seed=1)
    state, action = WORLDS["car"].observation[:3], WORLDS["car"].action[:3]
    expected = model.predict(state, action)
    for observation, actions in ((state.tolist(), action.tolist()), (state, action.tolist())):
        found = model.predict(observation, actions)
        assert isinstance(found, np.ndarray)
        np.testing.assert_array_equal(found, expected)
    assert isinstance(model.predict(torch.from_numpy(state), action), torch.Tensor)
    np.testing.assert_allclose(model.predict(state[1].tolist(), int(action[1])), expected[1], rtol=1e-6)
    assert model.rollout(state[0], [0, 2, 1]).shape == (3, 2)
    picked = model.address(torch.from_numpy(state), torch.from_numpy(action))
    np.testing.assert_array_equal(model.address(state, action), picked.numpy())
    assert model.probabilities(state.tolist(), action.tolist()).shape == (3, model.ensemble.members)
    assert model.member_predictions(state, action).shape == (model.ensemble.members, 3, 2)


@pytest.mark.parametrize(
    ("observation", "action", "said"),
    [
        ([[0.0, 1.0], [0.0]], [0, 1], "was given lists of different lengths"),
        ([["a", "b"]], [0], "was given values of type '<U1'"),
        ([0.0, 1.0, 2.0], 0, r"observations should have shape \(B, 2\), but have \(3,\)"),
    ],
)
def test_lists_of_a_wrong_form_are_refused_in_words_of_the_model(
    observation: list[Any], action: Any, said: str
) -> None:
    with pytest.raises(ModelError, match=said):
        untrained_model(WORLDS["car"], seed=1).predict(observation, action)


def test_outputs_of_members_are_decoded_from_arrays_as_from_tensors() -> None:
    model = untrained_model(WORLDS["car"], seed=1)
    state, action = WORLDS["car"].observation[:3], WORLDS["car"].action[:3]
    found = model.decode(model.member_outputs(state, action), state)
    np.testing.assert_array_equal(found, model.member_predictions(torch.from_numpy(state), action).numpy())


def test_a_model_says_what_it_is(folder: Path) -> None:
    said = repr(untrained_model(WORLDS["car"], seed=1))
    assert said == (
        "AddressedDynamics(mode argmax; states position, velocity; actions push_left, no_push, push_right; "
        "0.0333333 s a step; history 1; 3 x (5, 16, 8, 2), addressing (5, 12, 3); 861 parameters)"
    )
    assert "actions torque, brake;" in repr(untrained_model(WORLDS["arm"]))
    loaded = repr(AddressedDynamics.load(folder, mode="blend"))
    assert loaded.startswith(
        "AddressedDynamics(candidate ensemble, seed 4, variant cost_sensitive; mode blend; states "
    )
    alone = repr(AddressedDynamics.load(folder, candidate="relu_512", seed=5))
    assert alone.startswith("AddressedDynamics(candidate relu_512, seed 5; single network; states ")


@pytest.mark.parametrize("mode", MODES)
def test_a_model_is_loaded_in_any_mode_that_is_asked_for(folder: Path, mode: Mode) -> None:
    world = WORLDS["car"]
    for asked in ({}, {"seed": 2}, {"candidate": "ensemble", "variant": "plain"}):
        model = AddressedDynamics.load(folder, **asked, mode=mode)
        assert model.mode == mode
        found, expected = (
            model.predict(world.observation, world.action, each, generator=torch.Generator().manual_seed(0))
            for each in (None, mode)
        )
        np.testing.assert_array_equal(found, expected)


def test_a_mode_that_makes_no_sense_for_what_is_loaded_is_refused_in_one_line(folder: Path) -> None:
    with pytest.raises(ModelError, match=r"^there is no addressing mode 'phase' \(modes: argmax, [^\n]*$"):
        AddressedDynamics.load(folder, mode="phase")  # type: ignore[arg-type] # that is the point
    with pytest.raises(ModelError, match=r"^mode 'mixture' was asked for, but this is a single network[^\n]*$"):
        AddressedDynamics.load(folder, candidate="relu_512", mode="mixture")


def test_the_folder_of_one_model_leaves_nothing_to_choose(folder: Path) -> None:
    own = folder / "baselines" / "relu_512" / "seed-5"
    assert AddressedDynamics.load(own).ensemble.members == 1
    for asked in ({"candidate": "relu_512"}, {"seed": 3}, {"variant": "plain"}):
        with pytest.raises(ModelError, match=f"this is one saved model, of which no {next(iter(asked))} can be chosen"):
            AddressedDynamics.load(own, **asked)


def test_a_folder_that_holds_no_models_is_told_apart_from_one_that_is_not_whole(folder: Path, tmp_path: Path) -> None:
    shutil.copytree(folder, tmp_path / "car")
    with pytest.raises(
        ModelError, match=r"neither a saved model nor the models of an experiment.* \(folders in it: car\)"
    ):
        AddressedDynamics.load(tmp_path)


def test_models_that_name_their_runs_are_said_to_be_of_an_earlier_version(folder: Path, tmp_path: Path) -> None:
    old = shutil.copytree(folder, tmp_path / "car")
    (old / "delivered.json").unlink()
    (old / "ensemble" / "seed-4" / "mlflow_run.json").write_text('{"run_id": "1", "experiment_id": "1", "name": "x"}')
    with pytest.raises(
        ModelError, match=r"^[^\n]*earlier version .*'dvc repro evaluate@car', or load one by its 'seed'$"
    ):
        AddressedDynamics.load(old)
    assert is_of(AddressedDynamics.load(old, seed=4), 4, "cost_sensitive")


def test_a_model_of_the_first_version_is_refused_in_one_line(folder: Path, tmp_path: Path) -> None:
    old = shutil.copytree(folder, tmp_path / "car")
    for path in old.rglob("config.json"):
        config = json.loads(path.read_text())
        for name in ("history", "history_weight", "angles", "angle_from", "velocity"):
            del config["features"][name]
        del config["architecture"]["shared"]
        path.write_text(json.dumps(config))
    with pytest.raises(ModelError, match=r"^[^\n]*the first version of this package .* train it again: 'dvc repro'$"):
        AddressedDynamics.load(old, seed=4)


def test_a_model_saved_before_layers_could_be_shared_is_loaded(folder: Path, tmp_path: Path) -> None:
    old = shutil.copytree(folder, tmp_path / "car")
    for path in old.rglob("config.json"):
        config = json.loads(path.read_text())
        del config["architecture"]["shared"]
        path.write_text(json.dumps(config))
    assert is_of(AddressedDynamics.load(old), 4, "cost_sensitive")


@pytest.mark.parametrize("rows", [1, 7])
def test_weights_that_change_change_what_is_predicted(rows: int) -> None:
    model, world = untrained_model(WORLDS["car"]), WORLDS["car"]
    given = world.observation[:rows], world.action[:rows]
    before = model.predict(*given)
    with torch.no_grad():
        for bias in model.ensemble.biases:
            bias += 0.5
    after = model.predict(*given)
    np.testing.assert_allclose(after, naive(model, *given, "argmax"), rtol=1e-4, atol=1e-5)
    assert not np.allclose(after, before)


@pytest.mark.parametrize("world", WORLDS.values(), ids=WORLDS)
def test_samples_one_by_one_are_predicted_as_in_a_batch(world: Transitions) -> None:
    model = untrained_model(world)
    together = model.predict(world.observation, world.action)
    pairs = zip(world.observation, world.action, strict=True)
    alone = [model.predict(state, action) for state, action in pairs]
    np.testing.assert_allclose(alone, together, rtol=1e-5, atol=1e-6)
