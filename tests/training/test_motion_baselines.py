"""Baselines of motion make as many updates as the ensemble, up to a whole epoch."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.params.motion import BlendedNetwork
from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.training.baselines import as_single
from addressed_dynamics.training.epochs import updates_per_epoch
from addressed_dynamics.training.motion_baselines import blended_training, same_size, total_parameters

OPTIMISER = OptimiserParams(learning_rate=1e-3, betas=(0.9, 0.99), final_share=0.0)
ENSEMBLE = EnsembleParams(
    seeds=(0,), members=4, hidden=(32, 16), activation="elu", loss="mae", optimiser=OPTIMISER, batch_size=32,
    dropout=0.1, epochs=20, cluster_epochs=5, restart=True, processes=1,
)  # fmt: skip
BLENDED = BlendedNetwork(
    hidden=(32,), gate_hidden=(8,), members=3, activation="relu", loss="mse", optimiser=OPTIMISER, batch_size=16,
    dropout=0.3, weight_penalty=0.01,
)  # fmt: skip


def updates(recipe: Any, samples: int, members: int = 1) -> int:
    return int(recipe.epochs * updates_per_epoch(samples, members, recipe.batch_size))


@st.composite
def ensembles(draw: st.DrawFn) -> EnsembleParams:
    return ENSEMBLE.model_copy(
        update={
            "members": draw(st.integers(1, 8)),
            "epochs": draw(st.integers(1, 100)),
            "batch_size": draw(st.integers(1, 200)),
        }
    )


@given(ensemble=ensembles(), samples=st.integers(1, 5000), batch_size=st.integers(1, 200))
def test_every_baseline_makes_as_many_updates_as_the_ensemble_up_to_a_whole_epoch(
    ensemble: EnsembleParams, samples: int, batch_size: int
) -> None:
    wanted = updates(ensemble, samples, ensemble.members)
    trainings = [
        same_size(ensemble, samples),
        total_parameters(ensemble, 342, 311, samples),
        as_single(ensemble, {"batch_size": batch_size}, samples),
        blended_training(BLENDED.model_copy(update={"batch_size": batch_size}), ensemble, samples),
    ]
    for each in trainings:
        per_epoch = updates_per_epoch(samples, 1, each.batch_size)
        assert wanted <= updates(each, samples) < wanted + per_epoch


def test_a_blended_training_differs_from_its_network_by_its_length_alone() -> None:
    training = blended_training(BLENDED, ENSEMBLE, 1000)
    assert training.model_dump(exclude={"epochs"}) == BLENDED.model_dump()
    # 4 members with 250 samples each take 8 batches an epoch, the network 63.
    assert training.epochs == 3


def test_a_single_network_is_trained_as_a_member_is_but_for_what_is_said_of_it() -> None:
    same = {"hidden", "activation", "loss", "optimiser", "batch_size", "dropout", "seeds", "processes"}
    like_a_member = same_size(ENSEMBLE, 1000)
    assert like_a_member.model_dump(include=same) == ENSEMBLE.model_dump(include=same)
    assert (like_a_member.members, like_a_member.cluster_epochs, like_a_member.restart) == (1, 1, False)
    wide = total_parameters(ENSEMBLE, 342, 311, 1000)
    assert wide.model_dump(include=same - {"hidden"}) == ENSEMBLE.model_dump(include=same - {"hidden"})
    assert wide.hidden > ENSEMBLE.hidden
    other = as_single(ENSEMBLE, {"hidden": (5,), "activation": "tanh"}, 1000)
    assert (other.hidden, other.activation, other.loss) == ((5,), "tanh", "mae")


def test_what_it_returns_are_params_that_a_file_could_hold() -> None:
    for each in (same_size(ENSEMBLE, 10), total_parameters(ENSEMBLE, 342, 311, 10)):
        assert EnsembleParams.model_validate_json(each.model_dump_json()) == each
