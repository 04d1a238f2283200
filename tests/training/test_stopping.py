from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from learning import ENSEMBLE, car_samples

from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.stopping import Stopping

FEATURES, TRAIN, VALIDATION = car_samples()
WILD = ENSEMBLE.optimiser.model_copy(update={"learning_rate": 0.1, "final_share": 1.0})
"""So large a rate that the validation loss goes up and down."""
STOPPED = ENSEMBLE.model_copy(update={"optimiser": WILD, "epochs": 12, "early_stopping": 2})
SINGLE = STOPPED.model_copy(update={"members": 1, "cluster_epochs": 1})
RESTARTED = STOPPED.model_copy(update={"restart": True})


def train(params: EnsembleParams, **options: Any) -> Iterator[Epoch]:
    unit = FEATURES.loss_unit("mse")
    return train_ensemble(TRAIN, VALIDATION, params, seed=3, loss_unit=unit, **options)


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


def by_hand(losses: list[float], first: int, patience: int) -> tuple[int, int]:
    """The epoch that is kept and the one that is the last, found one epoch after the other."""
    best = first
    for epoch in range(first, len(losses) + 1):
        if losses[epoch - 1] < losses[best - 1]:
            best = epoch
        if epoch - best >= patience:
            return best, epoch
    return best, len(losses)


@given(
    st.lists(st.integers(0, 9).map(float), min_size=1, max_size=12).flatmap(
        lambda losses: st.tuples(st.just(losses), st.integers(1, len(losses)), st.integers(1, 4))
    )
)
def test_training_ends_after_so_many_epochs_without_a_lower_loss_and_keeps_the_lowest(
    case: tuple[list[float], int, int],
) -> None:
    losses, first, patience = case
    stopping = Stopping(len(losses), patience, "loss", first)
    history = [{"loss": loss} for loss in losses]
    last = next(epoch for epoch in range(1, len(losses) + 1) if stopping.ends(history[:epoch]))
    assert (stopping.kept(history[:last]), last) == by_hand(losses, first, patience)


def test_without_patience_the_last_epoch_is_kept() -> None:
    stopping, history = Stopping(3, None, "loss"), [{"loss": loss} for loss in (1.0, 2.0, 3.0)]
    assert [stopping.ends(history[:epoch]) for epoch in (1, 2, 3)] == [False, False, True]
    assert stopping.kept(history) == 3


@pytest.mark.parametrize("params", [STOPPED, SINGLE, RESTARTED])
def test_the_networks_are_those_of_the_epoch_with_the_lowest_validation_loss(params: EnsembleParams) -> None:
    through = [(weights(each), each.metrics) for each in train(params.model_copy(update={"early_stopping": None}))]
    losses = [metrics["loss/validation"] for _, metrics in through]
    kept, ended = by_hand(losses, params.cluster_epochs + 1 if params.restart else 1, 2)
    *_, last = train(params)
    assert kept < ended
    assert (last.index, last.last) == (ended, True)
    assert weights(last) == through[kept - 1][0]
    assert last.metrics == through[kept - 1][1] | {"epoch/kept": kept}


@pytest.mark.parametrize("params", [STOPPED, SINGLE, RESTARTED])
def test_a_training_that_is_cut_off_keeps_the_same_bytes(tmp_path: Path, params: EnsembleParams) -> None:
    straight = [(each.index, each.last, each.metrics) for each in train(params)]
    *_, expected = train(params)
    for finished in range(1, len(straight) + 1):
        checkpoint = Checkpoint(tmp_path / f"{finished}.safetensors")
        for _ in islice(train(params, checkpoint=checkpoint), finished):
            pass
        resumed = list(train(params, checkpoint=checkpoint))
        assert [(each.index, each.last, each.metrics) for each in resumed] == straight
        assert weights(resumed[-1]) == weights(expected)


def test_a_checkpoint_of_a_training_that_is_not_stopped_holds_nothing_more(tmp_path: Path) -> None:
    names = []
    for params in (ENSEMBLE, STOPPED):
        checkpoint = Checkpoint(tmp_path / "state.safetensors")
        next(train(params, checkpoint=checkpoint))
        names.append(set(checkpoint.load()[1]))
        checkpoint.remove()
    assert names[1] - names[0] == {"kept"}
    assert not names[0] - names[1]
