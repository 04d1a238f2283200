import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from learning import ADDRESSING, ENSEMBLE, drive, untrained_model

from addressed_dynamics.base.errors import EvaluationError, ModelError
from addressed_dynamics.episodes.splits import Split
from addressed_dynamics.evaluation.transitions.candidates import (
    Candidate,
    baseline_candidates,
    baseline_label,
    ensemble_candidates,
    load_other_recipe,
    recorded_change,
)
from addressed_dynamics.evaluation.transitions.one_step import predict_all
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import OtherRecipe
from addressed_dynamics.evaluation.transitions.suite import (
    evaluate_candidate,
    evaluate_other_recipe,
    evaluate_specialisation,
)
from addressed_dynamics.networks import stacked
from addressed_dynamics.networks.files import SavedNetwork, save_network
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.simulators.addressed import AddressedDynamics

WORLD = drive()
RECIPE = {
    "ensemble": ENSEMBLE.model_copy(update={"loss": "mae"}).model_dump(mode="json"),
    "addressing": ADDRESSING.model_dump(mode="json"),
}


def save_baseline(folder: Path, key: str, model: AddressedDynamics, notes: Mapping[str, Any] | None = None) -> None:
    save_network(folder / key / "network", SavedNetwork(model.ensemble, model.features, dict(notes or {})))
    if model.addressing is not None:
        save_network(folder / key / "addressing", SavedNetwork(model.addressing, model.features, {}))


def test_baselines_are_candidates_with_their_size_and_the_pair_is_none(tmp_path: Path) -> None:
    world = drive()
    single, several, pair = (untrained_model(world, members) for members in (1, 3, 2))
    trained = {"large/seed-0": single, "unequal_bins/seed-2": several}
    for key, model in {**trained, "pair/seed-0": pair}.items():
        save_baseline(tmp_path, key, model)
    index = {"format": 1, "trained": list(trained), "pair": ["pair/seed-0"]}
    (tmp_path / "baselines.json").write_text(json.dumps(index))
    found = baseline_candidates(tmp_path, untrained_model(WORLD))
    assert [each.name for each in found] == list(trained)
    labels = ["one network, tanh 16 × 8, seed 0", "ensemble without equal bins, seed 2"]
    assert [each.label for each in found] == labels
    network = (5 + 1) * 16 + (16 + 1) * 8 + (8 + 1) * 2
    assert [each.parameters for each in found] == [network, 3 * network + (5 + 1) * 12 + (12 + 1) * 3]
    products = 5 * 16 + 16 * 8 + 8 * 2
    assert [each.multiply_adds for each in found] == [products, products + 5 * 12 + 12 * 3]


@pytest.mark.parametrize(
    ("name", "widths", "label"),
    [
        ("wide", (5, 512, 512, 512, 2), "one network, relu 512 × 512 × 512"),
        ("small", (5, 2), "one linear map"),
        ("same_size", (5, 128, 128, 2), "one network, as large as a member"),
        ("paper_recipe", (5, 16, 2), "ensemble, the paper's recipe"),
        ("default_recipe", (5, 16, 2), "ensemble, the default recipe"),
    ],
)
def test_a_single_network_says_what_it_is(name: str, widths: tuple[int, ...], label: str) -> None:
    assert baseline_label(name, StackedMLP(1, widths, "relu")) == label


def save_recipes(folder: Path, model: AddressedDynamics, notes: Mapping[str, Any]) -> Path:
    save_baseline(folder, "large/seed-0", untrained_model(WORLD, 1))
    save_baseline(folder, "paper_recipe/seed-0", model, notes)
    index = {"format": 1, "trained": ["large/seed-0", "paper_recipe/seed-0"], "pair": []}
    (folder / "baselines.json").write_text(json.dumps(index))
    return folder


def test_the_other_recipe_is_judged_with_its_own_features_and_loss(tmp_path: Path) -> None:
    model = untrained_model(WORLD, 3, target="absolute")
    other = load_other_recipe(save_recipes(tmp_path, model, {"params": RECIPE}))
    assert other is not None
    delivered = untrained_model(WORLD, 2).features
    points: dict[Split, Points] = {"train": Points.of(WORLD, delivered), "test": Points.of(drive((30,)), delivered)}
    found = evaluate_other_recipe(other, points)
    with_its_features = Points.of(WORLD, model.features)
    assert found["specialisation"]["train"] == evaluate_specialisation(model, with_its_features, "mae")
    assert found["specialisation"]["test"]["samples"] == 30
    record = OtherRecipe.model_validate_json(json.dumps(found))
    assert record.name == "paper_recipe"
    assert (record.recipe.features.target, record.recipe.ensemble.loss) == ("absolute", "mae")
    assert record.recipe.addressing == ADDRESSING
    assert [each.label for each in baseline_candidates(tmp_path, untrained_model(WORLD))][
        1
    ] == "ensemble, the paper's recipe, seed 0"


def test_there_may_be_no_other_recipe(tmp_path: Path) -> None:
    (tmp_path / "baselines.json").write_text(json.dumps({"format": 1, "trained": ["large/seed-0"], "pair": []}))
    assert load_other_recipe(tmp_path) is None


@pytest.mark.parametrize("notes", [{}, {"params": {"ensemble": RECIPE["ensemble"]}}, {"params": RECIPE["ensemble"]}])
def test_another_recipe_that_does_not_say_what_it_is_is_refused(tmp_path: Path, notes: dict[str, Any]) -> None:
    folder = save_recipes(tmp_path, untrained_model(WORLD, 3), notes)
    with pytest.raises(ModelError, match=r"its notes should have the recipe under 'params'; run train_baselines again"):
        load_other_recipe(folder)


def test_a_candidate_that_is_given_more_frames_than_the_delivered_model_is_refused(tmp_path: Path) -> None:
    folder = save_recipes(tmp_path, untrained_model(WORLD, 3, history=4), {"params": RECIPE})
    single, other = baseline_candidates(folder, untrained_model(WORLD))
    points = Points.of(WORLD, untrained_model(WORLD, 2).features)
    assert evaluate_candidate(single, points, "mse")["parameters"] == single.parameters
    assert evaluate_candidate(single, points, "mse")["multiply_adds"] == single.multiply_adds is not None
    with pytest.raises(EvaluationError, match=r"delivered model, 1, but 'paper_recipe/seed-0' is given 4"):
        evaluate_candidate(other, points, "mse")


def sampling() -> Candidate:
    models = {0: {"plain": untrained_model(WORLD, 3)}}
    return next(each for each in ensemble_candidates(models, {0: "plain"}) if each.name == "ensemble/sample")


@pytest.mark.parametrize("rows", [10, 20])
def test_sampling_draws_the_same_members_in_chunks_as_at_once(monkeypatch: pytest.MonkeyPatch, rows: int) -> None:
    points = Points.of(WORLD, untrained_model(WORLD, 3).features)
    at_once = predict_all(sampling().predictor, points)
    monkeypatch.setattr(stacked, "CHUNK_ROWS", rows)
    assert len(points) > rows
    torch.testing.assert_close(predict_all(sampling().predictor, points), at_once)


def test_sampling_draws_other_members_in_the_next_chunk(monkeypatch: pytest.MonkeyPatch) -> None:
    same_point = Points(untrained_model(WORLD, 3).features, WORLD, np.zeros(40, np.int64))
    monkeypatch.setattr(stacked, "CHUNK_ROWS", 20)
    first, second = predict_all(sampling().predictor, same_point).split(20)
    assert not torch.allclose(first, second)


def test_with_one_frame_the_last_change_is_read_from_the_recording_and_is_nothing_in_the_first_step() -> None:
    points = Points.of(WORLD, untrained_model(WORLD).features)
    (candidate,) = recorded_change(points.features)
    assert candidate.model is None
    assert (candidate.parameters, candidate.multiply_adds) == (0, 0)
    rows = torch.tensor([7, 40, 3, 0, 41])  # the second episode begins at 40
    states = WORLD.observation
    expected = np.stack([2 * states[7] - states[6], states[40], 2 * states[3] - states[2], states[0],
                         2 * states[41] - states[40]])  # fmt: skip
    np.testing.assert_allclose(candidate.predictor(points, rows), expected, atol=1e-6)


def test_with_frames_the_last_change_is_a_model_and_not_read_from_the_recording() -> None:
    assert recorded_change(untrained_model(WORLD, history=2).features) == []


def test_references_are_candidates_without_a_seed_and_with_their_own_costs(tmp_path: Path) -> None:
    features = untrained_model(WORLD, history=2).features
    linear = StackedMLP(1, (features.inputs, features.outputs), "relu")
    keys = [f"{name}/seed-0" for name in ("persistence", "last_change", "linear", "linear_frame")]
    for key in keys:
        save_baseline(tmp_path, key, AddressedDynamics(features, linear, None))
    (tmp_path / "baselines.json").write_text(json.dumps({"format": 1, "trained": keys, "pair": []}))
    found = baseline_candidates(tmp_path, untrained_model(WORLD))
    labels = ["nothing changes", "the last change goes on", "linear least squares",
              "linear least squares of the last frame"]  # fmt: skip
    assert [each.label for each in found] == labels
    assert [(each.parameters, each.multiply_adds) for each in found] == [(0, 0), (0, 0), (22, 20), (12, 10)]


@pytest.mark.parametrize(
    ("widths", "label"),
    [
        ((5, 39, 15, 2), "as many parameters as members and addressing together"),
        ((5, 30, 15, 2), "677 parameters, where members and addressing have 861"),
    ],
)
def test_one_network_as_large_as_the_model_is_called_so_only_if_it_is(
    tmp_path: Path, widths: tuple[int, ...], label: str
) -> None:
    own = untrained_model(WORLD)
    assert own.addressing is not None
    assert own.ensemble.parameters_total + own.addressing.parameters_total == 861
    save_baseline(
        tmp_path, "total_parameters/seed-0", AddressedDynamics(own.features, StackedMLP(1, widths, "relu"), None)
    )
    index = {"format": 1, "trained": ["total_parameters/seed-0"], "pair": []}
    (tmp_path / "baselines.json").write_text(json.dumps(index))
    assert [each.label for each in baseline_candidates(tmp_path, own)] == [f"one network, {label}, seed 0"]
