import json
from typing import Any

import pytest
import torch
from example_params import EXAMPLE
from learning import ADDRESSING, CHANGE, ENSEMBLE, car_samples

from addressed_dynamics.base.params.experiments import ExperimentParams
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.training.baselines import ONCE, PAIR, Baseline, hidden_of_total_parameters, plan_baselines
from addressed_dynamics.training.ensemble import train_ensemble, untrained_ensemble
from addressed_dynamics.training.epochs import updates_per_epoch

FEATURES, TRAIN, VALIDATION = car_samples()
SINGLE_NETWORKS = {
    "wide": {"hidden": [24, 24, 24], "activation": "relu", "batch_size": 10},
    "narrow": {"hidden": [8], "activation": "tanh", "batch_size": 16},
}
TRAINED = ("total_parameters", "unequal_bins", "random_bins", "other_recipe")


def experiment(**changes: Any) -> ExperimentParams:
    section = EXAMPLE | {
        "features": CHANGE.model_dump(mode="json"),
        "ensemble": ENSEMBLE.model_dump(mode="json"),
        "baselines": {
            "train": TRAINED,
            "single_networks": SINGLE_NETWORKS,
            "pair_epochs": 3,
            "seeds": [0],
            "addressing": ADDRESSING.model_dump(mode="json"),
            "processes": 1,
        },
    }
    return ExperimentParams.model_validate_json(json.dumps(section | changes))


PAPER = experiment(recipe="paper", features={"target": "absolute"})


def planned(chosen: ExperimentParams | None = None, other: ExperimentParams = PAPER) -> dict[str, Baseline]:
    return plan_baselines(chosen or experiment(), other, TRAIN.x.shape[1], TRAIN.y.shape[1], len(TRAIN))


@pytest.mark.parametrize("members", [2, 4, 8])
@pytest.mark.parametrize(
    ("inputs", "hidden", "outputs"),
    [(5, (128, 128), 2), (54, (256, 256, 256), 4), (342, (512, 512), 311), (5, (64,), 2)],
)
def test_one_network_gets_as_many_parameters_as_the_members_have_together(
    inputs: int, hidden: tuple[int, ...], outputs: int, members: int
) -> None:
    found = hidden_of_total_parameters(inputs, outputs, hidden, members)
    one = StackedMLP(1, (inputs, *found, outputs), "relu").parameters_per_member
    all_members = members * StackedMLP(1, (inputs, *hidden, outputs), "relu").parameters_per_member
    assert one == pytest.approx(all_members, rel=0.01)
    assert len(found) == len(hidden)


def test_one_member_gets_its_own_widths() -> None:
    assert hidden_of_total_parameters(5, 2, (128, 64), 1) == (128, 64)


@pytest.mark.parametrize("name", ["wide", "narrow", "total_parameters", "unequal_bins", "random_bins"])
def test_a_baseline_makes_as_many_updates_as_the_ensemble(name: str) -> None:
    *_, ensemble = train_ensemble(TRAIN, VALIDATION, ENSEMBLE, seed=0, loss_unit=1.0)
    baseline = planned()[name]
    recipe = baseline.ensemble
    *_, last = train_ensemble(TRAIN, VALIDATION, recipe, seed=0, loss_unit=1.0, binning=baseline.binning)
    per_epoch = updates_per_epoch(len(TRAIN), recipe.members, recipe.batch_size)
    assert ensemble.updates <= last.updates < ensemble.updates + per_epoch


def test_an_ablation_differs_by_its_bins_alone_and_a_single_network_by_its_shape() -> None:
    plan = planned()
    assert list(plan) == [*SINGLE_NETWORKS, "total_parameters", "unequal_bins", "random_bins", "paper_recipe", PAIR]
    for name, binning in {"unequal_bins": "lowest_loss", "random_bins": "random"}.items():
        assert plan[name] == Baseline(CHANGE, ENSEMBLE, binning, ADDRESSING)
    recipes = {name: plan[name].ensemble for name in ("wide", "narrow", "total_parameters")}
    shapes = {name: (each.members, each.hidden, each.activation, each.batch_size) for name, each in recipes.items()}
    assert shapes["wide"] == (1, (24, 24, 24), "relu", 10)
    assert shapes["narrow"] == (1, (8,), "tanh", 16)
    assert (shapes["total_parameters"][0], shapes["total_parameters"][2:]) == (1, (ENSEMBLE.activation, 8))
    for name, recipe in recipes.items():
        same = {"optimiser", "loss"}
        assert recipe.model_dump(include=same) == ENSEMBLE.model_dump(include=same)
        assert plan[name].addressing is None


def test_the_recipe_that_was_not_chosen_is_trained_once_as_it_is_with_its_own_features_and_addressing() -> None:
    default = experiment()
    expected = Baseline(PAPER.features, PAPER.ensemble, "equal", ADDRESSING)
    assert planned(default, PAPER)["paper_recipe"] == expected
    assert planned(PAPER, default)["default_recipe"] == Baseline(CHANGE, ENSEMBLE, "equal", ADDRESSING)
    assert set(ONCE) == {"paper_recipe", "default_recipe", PAIR}


def test_the_pair_is_an_ensemble_of_two_that_trains_for_epochs_of_its_own_and_starts_from_known_networks() -> None:
    three = ENSEMBLE.model_copy(update={"members": 3})
    pair = planned(experiment(ensemble=three.model_dump(mode="json")))[PAIR].ensemble
    assert (pair.members, pair.epochs) == (2, 3)
    assert pair.model_copy(update={"members": 3, "epochs": three.epochs}) == three
    still = pair.model_copy(update={"optimiser": pair.optimiser.model_copy(update={"learning_rate": 1e-30})})
    *_, last = train_ensemble(TRAIN, VALIDATION, still, seed=4, loss_unit=1.0)
    start = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], pair, seed=4)
    assert (last.index, last.network.members) == (3, 2)
    assert all(torch.equal(a, b) for a, b in zip(last.network.parameters(), start.parameters(), strict=True))


def test_without_epochs_there_is_no_pair() -> None:
    baselines = experiment().baselines.model_dump(mode="json") | {"pair_epochs": 0}
    assert PAIR not in planned(experiment(baselines=baselines))
