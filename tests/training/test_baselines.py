import json
from typing import Any

import pytest
import torch
from example_params import EXAMPLE
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import ADDRESSING, CHANGE, ENSEMBLE, car_samples
from pydantic import ValidationError

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import BlendedNetwork, EnsembleParams
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.sources.transitions.params import ExperimentParams
from addressed_dynamics.training.addressing import untrained_addressing
from addressed_dynamics.training.baselines import (
    PAIR,
    Baseline,
    as_single,
    blended_training,
    ensemble_updates,
    hidden_of_total_parameters,
    plan_baselines,
    same_size,
    total_parameters,
)
from addressed_dynamics.training.blended import train_gated
from addressed_dynamics.training.ensemble import train_ensemble, untrained_ensemble
from addressed_dynamics.training.epochs import Length, updates_per_epoch

FEATURES, TRAIN, VALIDATION = car_samples()
SINGLE_NETWORKS = {
    "wide": {"hidden": [24, 24, 24], "activation": "relu", "batch_size": 10},
    "narrow": {"hidden": [8], "activation": "tanh", "batch_size": 16},
}
TRAINED = ("total_parameters", "same_size", "unequal_bins", "random_bins", "other_recipe")


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
        },
    }
    return ExperimentParams.model_validate_json(json.dumps(section | changes))


PAPER = experiment(recipe="paper", features={"target": "absolute"})


def planned(
    chosen: ExperimentParams | None = None,
    other: ExperimentParams = PAPER,
    phase_features: Any = None,
    *,
    members: int = 2,
) -> dict[str, Baseline]:
    shapes = TRAIN.x.shape[1], TRAIN.y.shape[1], len(TRAIN)
    return plan_baselines(chosen or experiment(), other, members, *shapes, phase_features)


def test_members_that_validation_chose_are_those_of_both_recipes_and_of_all_that_is_compared() -> None:
    left_open = ENSEMBLE.model_dump(mode="json") | {"members": "auto"}
    chosen, other = experiment(ensemble=left_open), experiment(ensemble=left_open, recipe="paper")
    plan = planned(chosen, other, members=4)
    assert {name: each.training.members for name, each in plan.items() if not name.endswith("_bins")} == {
        "wide": 1, "narrow": 1, "total_parameters": 1, "same_size": 1, "paper_recipe": 4, PAIR: 2
    }  # fmt: skip
    assert plan["unequal_bins"].training.members == 4
    shapes = TRAIN.x.shape[1], TRAIN.y.shape[1], len(TRAIN)
    assert plan["total_parameters"].training == total_parameters(chosen.ensemble.with_members(4), ADDRESSING, *shapes)


def test_the_other_recipe_keeps_a_number_of_its_own() -> None:
    other = experiment(ensemble=ENSEMBLE.model_dump(mode="json") | {"members": 3}, recipe="paper")
    assert planned(other=other, members=2)["paper_recipe"].training.members == 3


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


@pytest.mark.parametrize("heads", [(), (8, 8)])
def test_one_network_gets_as_many_parameters_as_members_and_addressing_have_together(heads: tuple[int, ...]) -> None:
    ensemble = ENSEMBLE.model_copy(update={"members": 4, "hidden": (64, 64)})
    addressing = ADDRESSING.model_copy(update={"hidden": (96, 32), "heads": heads})
    found = total_parameters(ensemble, addressing, 20, 4, 1000)
    one = StackedMLP(1, (20, *found.hidden, 4), "relu").parameters_total
    members = StackedMLP(4, (20, 64, 64, 4), "relu").parameters_total
    picks = untrained_addressing(20, 4, addressing, seed=0).parameters_total
    assert picks > 0.2 * members
    assert one == pytest.approx(members + picks, rel=0.02)
    planning = plan_baselines(experiment(), PAPER, 2, 5, 2, len(TRAIN))["total_parameters"].training
    assert planning == total_parameters(ENSEMBLE, ADDRESSING, 5, 2, len(TRAIN)).model_copy()


def test_one_member_gets_its_own_widths() -> None:
    assert hidden_of_total_parameters(5, 2, (128, 64), 1) == (128, 64)


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("name", ["wide", "narrow", "total_parameters", "unequal_bins", "random_bins"])
def test_a_baseline_makes_exactly_as_many_updates_as_the_ensemble_those_before_a_restart_included(
    name: str, restart: bool
) -> None:
    recipe = ENSEMBLE.model_copy(update={"restart": restart})
    *_, ensemble = train_ensemble(TRAIN, VALIDATION, recipe, seed=0, loss_unit=1.0)
    baseline = planned(experiment(ensemble=recipe.model_dump(mode="json")))[name]
    *_, last = train_ensemble(
        TRAIN, VALIDATION, baseline.training, seed=0, loss_unit=1.0, binning=baseline.binning, updates=baseline.updates
    )
    assert last.last
    assert last.updates == ensemble.updates == ensemble_updates(recipe, len(TRAIN))


@settings(max_examples=25, deadline=None)
@given(
    samples=st.integers(6, 60), members=st.integers(1, 5), sizes=st.tuples(st.integers(1, 20), st.integers(1, 20)),
    epochs=st.integers(1, 4),
)  # fmt: skip
def test_trainings_of_one_network_and_of_a_mixture_end_at_the_update_at_which_the_ensemble_ends(
    samples: int, members: int, sizes: tuple[int, int], epochs: int
) -> None:
    train = Samples(TRAIN.x[:samples], TRAIN.y[:samples], TRAIN.episode[:samples], TRAIN.step[:samples])
    recipe = ENSEMBLE.model_copy(
        update={"members": members, "batch_size": sizes[0], "epochs": epochs, "cluster_epochs": 1}
    )
    *_, ensemble = train_ensemble(train, VALIDATION, recipe, seed=0, loss_unit=1.0)
    exact = {"seed": 0, "updates": ensemble_updates(recipe, samples)}
    single = as_single(recipe, {"batch_size": sizes[1]}, samples)
    *_, one = train_ensemble(train, VALIDATION, single, loss_unit=1.0, **exact)
    mixture = blended_training(BLENDED.model_copy(update={"batch_size": sizes[1]}), recipe, samples)
    *_, mixed = train_gated(train, VALIDATION, mixture, **exact)
    assert one.updates == mixed.updates == ensemble.updates
    assert one.samples == mixed.samples <= ensemble.updates * sizes[1]
    assert ensemble.samples == epochs * samples


def test_an_ablation_differs_by_its_bins_alone_and_a_single_network_by_its_shape() -> None:
    chosen = experiment()
    plan = planned(chosen)
    assert list(plan) == [*SINGLE_NETWORKS, *TRAINED[:-1], "paper_recipe", PAIR]
    for name, binning in {"unequal_bins": "lowest_loss", "random_bins": "random"}.items():
        assert plan[name] == Baseline(chosen, chosen.features, ENSEMBLE, binning, ADDRESSING)
    recipes = {name: plan[name].training for name in ("wide", "narrow", "total_parameters", "same_size")}
    shapes = {name: (each.members, each.hidden, each.activation, each.batch_size) for name, each in recipes.items()}
    assert shapes["wide"] == (1, (24, 24, 24), "relu", 10)
    assert shapes["narrow"] == (1, (8,), "tanh", 16)
    assert (shapes["total_parameters"][0], shapes["total_parameters"][2:]) == (1, (ENSEMBLE.activation, 8))
    assert shapes["same_size"] == (1, ENSEMBLE.hidden, ENSEMBLE.activation, 8)
    for name, recipe in recipes.items():
        same = {"optimiser", "loss"}
        assert recipe.model_dump(include=same) == ENSEMBLE.model_dump(include=same)
        assert plan[name].addressing is None


def test_the_recipe_that_was_not_chosen_is_trained_as_it_is_with_its_own_features_and_addressing() -> None:
    default = experiment()
    expected = Baseline(PAPER, PAPER.features, PAPER.ensemble.with_members(2), "equal", ADDRESSING)
    assert planned(default, PAPER)["paper_recipe"] == expected
    expected = Baseline(default, default.features, ENSEMBLE, "equal", ADDRESSING)
    assert planned(PAPER, default)["default_recipe"] == expected


def test_the_pair_is_an_ensemble_of_two_that_trains_for_epochs_of_its_own_and_starts_from_known_networks() -> None:
    three = ENSEMBLE.model_copy(update={"members": 3})
    pair = planned(experiment(ensemble=three.model_dump(mode="json")))[PAIR].training
    assert isinstance(pair, EnsembleParams)
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


def test_networks_that_a_phase_mixes_need_data_with_a_phase_and_see_them_as_pfnn_does() -> None:
    blended = BLENDED.model_dump(mode="json")
    section = experiment().baselines.model_dump(mode="json") | {"train": ["phase_functioned", "learned_blend"]}
    with pytest.raises(ValidationError, match="no section 'phase_functioned' that says how"):
        experiment(baselines=section)
    chosen = experiment(baselines=section | {"phase_functioned": blended, "learned_blend": blended})
    with pytest.raises(ParamsError, match="'phase_functioned' needs data with a phase"):
        planned(chosen)
    plan = planned(chosen, phase_features="those of PFNN")
    assert (plan["phase_functioned"].features, plan["phase_functioned"].by_phase) == ("those of PFNN", True)
    assert (plan["learned_blend"].features, plan["learned_blend"].by_phase) == (chosen.features, False)
    assert plan["learned_blend"].updates == ensemble_updates(ENSEMBLE, len(TRAIN))


OPTIMISER = OptimiserParams(learning_rate=1e-3, betas=(0.9, 0.99), final_share=0.0)
RESTARTED = EnsembleParams(
    seeds=(0,), members=4, hidden=(32, 16), activation="elu", loss="mae", optimiser=OPTIMISER, batch_size=32,
    dropout=0.1, epochs=20, cluster_epochs=5, restart=True,
)  # fmt: skip
BLENDED = BlendedNetwork(
    hidden=(32,), gate_hidden=(8,), members=3, activation="relu", loss="mse", optimiser=OPTIMISER, batch_size=16,
    dropout=0.3, weight_penalty=0.01,
)  # fmt: skip


@st.composite
def ensembles(draw: st.DrawFn) -> EnsembleParams:
    return RESTARTED.model_copy(
        update={
            "members": draw(st.integers(1, 8)),
            "epochs": draw(st.integers(1, 100)),
            "batch_size": draw(st.integers(1, 200)),
        }
    )


@given(ensemble=ensembles(), samples=st.integers(1, 5000), batch_size=st.integers(1, 200))
def test_the_epochs_of_every_baseline_hold_as_many_updates_as_the_ensemble_makes_and_the_last_is_needed(
    ensemble: EnsembleParams, samples: int, batch_size: int
) -> None:
    wanted = ensemble_updates(ensemble, samples)
    assert wanted == ensemble.epochs * updates_per_epoch(samples, ensemble.members, ensemble.batch_size)
    trainings = [
        same_size(ensemble, samples),
        total_parameters(ensemble, ADDRESSING, 342, 311, samples),
        as_single(ensemble, {"batch_size": batch_size}, samples),
        blended_training(BLENDED.model_copy(update={"batch_size": batch_size}), ensemble, samples),
    ]
    for each in trainings:
        length = Length.of(samples, 1, each.batch_size, epochs=each.epochs, updates=wanted)
        assert length.epochs == each.epochs
        assert sum(length.updates_in(epoch) for epoch in range(1, each.epochs + 1)) == wanted


def test_a_blended_training_differs_from_its_network_by_its_length_alone() -> None:
    training = blended_training(BLENDED, RESTARTED, 1000)
    assert training.model_dump(exclude={"epochs"}) == BLENDED.model_dump()
    # 4 members with 250 samples each take 8 batches an epoch, the network 63.
    assert training.epochs == 3


def test_a_single_network_is_trained_as_a_member_is_but_for_what_is_said_of_it() -> None:
    same = {"hidden", "activation", "loss", "optimiser", "batch_size", "dropout", "seeds"}
    like_a_member = same_size(RESTARTED, 1000)
    assert like_a_member.model_dump(include=same) == RESTARTED.model_dump(include=same)
    assert (like_a_member.members, like_a_member.cluster_epochs, like_a_member.restart) == (1, 1, False)
    wide = total_parameters(RESTARTED, ADDRESSING, 342, 311, 1000)
    assert wide.model_dump(include=same - {"hidden"}) == RESTARTED.model_dump(include=same - {"hidden"})
    assert wide.hidden > RESTARTED.hidden
    other = as_single(RESTARTED, {"hidden": (5,), "activation": "tanh"}, 1000)
    assert (other.hidden, other.activation, other.loss) == ((5,), "tanh", "mae")


def test_what_it_returns_are_params_that_a_file_could_hold() -> None:
    for each in (same_size(RESTARTED, 10), total_parameters(RESTARTED, ADDRESSING, 342, 311, 10)):
        assert EnsembleParams.model_validate_json(each.model_dump_json()) == each
