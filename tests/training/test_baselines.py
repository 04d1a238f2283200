import pytest
from learning import ADDRESSING, ENSEMBLE, car_samples

from addressed_dynamics.models.stacked import StackedMLP
from addressed_dynamics.params import BaselinesParams
from addressed_dynamics.training.baselines import ABLATIONS, baseline_params, hidden_of_total_parameters
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import updates_per_epoch

FEATURES, TRAIN, VALIDATION = car_samples()
BASELINES = BaselinesParams(
    train=("total_parameters", "wide", "unequal_bins", "random_bins"),
    wide_hidden=(24, 24, 24),
    wide_batch_size=10,
    seeds=(0,),
    addressing=ADDRESSING,
    processes=1,
)


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


@pytest.mark.parametrize("name", BASELINES.train)
def test_a_baseline_makes_as_many_updates_as_the_ensemble(name: str) -> None:
    *_, ensemble = train_ensemble(TRAIN, VALIDATION, ENSEMBLE, seed=0, loss_unit=1.0)
    recipe = baseline_params(name, ENSEMBLE, BASELINES, TRAIN)
    binning = ABLATIONS.get(name, "equal")
    *_, last = train_ensemble(TRAIN, VALIDATION, recipe, seed=0, loss_unit=1.0, binning=binning)
    per_epoch = updates_per_epoch(len(TRAIN), recipe.members, recipe.batch_size)
    assert ensemble.updates <= last.updates < ensemble.updates + per_epoch


def test_an_ablation_differs_by_its_bins_alone_and_a_single_network_by_its_shape() -> None:
    recipes = {name: baseline_params(name, ENSEMBLE, BASELINES, TRAIN) for name in BASELINES.train}
    assert recipes["unequal_bins"] == recipes["random_bins"] == ENSEMBLE
    assert ABLATIONS["unequal_bins"] != ABLATIONS["random_bins"]
    wide, alike = recipes["wide"], recipes["total_parameters"]
    assert (wide.members, wide.hidden, wide.batch_size) == (1, (24, 24, 24), 10)
    assert (alike.members, alike.batch_size) == (1, ENSEMBLE.batch_size)
    for name in ("wide", "total_parameters"):
        same = {"optimiser", "loss", "activation"}
        assert recipes[name].model_dump(include=same) == ENSEMBLE.model_dump(include=same)
