"""What several processes find together does not depend on their number; threads stand for the processes here."""

import threading
from typing import Any

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from learning import CHANGE, ENSEMBLE, drive
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.stacked import CHUNK_ROWS
from addressed_dynamics.training import shares as sharing
from addressed_dynamics.training.ensemble import train_ensemble
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.shares import Shares

WORLD = drive((20,) * 10)
FEATURES = fit_features(WORLD, CHANGE)
TRAIN, VALIDATION = (FEATURES.samples(world, courses=True) for world in (WORLD, drive((15,) * 4, seed=1)))


class Meeting:
    """Where threads hand over what they have."""

    def __init__(self, workers: int) -> None:
        self.barrier = threading.Barrier(workers)
        self.parts: list[Tensor] = [torch.empty(0)] * workers


class ThreadShares(Shares):
    """The shares of a thread."""

    meeting: Meeting

    def _gathered(self, own: Tensor) -> Tensor:
        self.meeting.parts[self.rank] = own
        self.meeting.barrier.wait()
        everything = torch.cat(self.meeting.parts)
        self.meeting.barrier.wait()
        return everything


def together(workers: int, count: int, work: Any) -> list[Any]:
    """Return what `work(shares)` gives in every one of some threads that share their work."""
    meeting, results = Meeting(workers), [None] * workers

    def run(rank: int) -> None:
        own = ThreadShares(count, workers, rank)
        object.__setattr__(own, "meeting", meeting)
        results[rank] = work(own)

    threads = [threading.Thread(target=run, args=(rank,)) for rank in range(workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return results


@given(samples=st.integers(0, 30), count=st.sampled_from([1, 2, 4, 8]), seed=st.integers(0, 9))
def test_a_sum_over_parts_has_the_same_bits_for_any_number_of_workers(samples: int, count: int, seed: int) -> None:
    values = torch.randn(samples, 3, generator=torch.Generator().manual_seed(seed))
    alone = Shares(count).summed(lambda part: values[part].sum(dim=0), samples)
    torch.testing.assert_close(alone, values.sum(dim=0))
    for workers in (each for each in (1, 2, 4, 8) if count % each == 0):
        for found in together(workers, count, lambda own: own.summed(lambda part: values[part].sum(dim=0), samples)):
            assert torch.equal(found, alone)


@given(samples=st.integers(0, 3 * CHUNK_ROWS + 5), workers=st.sampled_from([2, 3, 4]))
def test_what_is_found_for_all_samples_is_whole_and_in_order(samples: int, workers: int) -> None:
    expected = torch.arange(samples).unsqueeze(1).float()
    for found in together(
        workers, workers, lambda own: own.of_all(lambda rows: torch.tensor(rows).view(-1, 1).float(), samples)
    ):
        assert torch.equal(found, expected)


def trained(shares: Shares, monkeypatch_target: threading.local, **changes: Any) -> Epoch:
    monkeypatch_target.own = shares
    params = ENSEMBLE.model_copy(update={"shares": shares.count, **changes})
    *_, last = train_ensemble(TRAIN, VALIDATION, params, seed=0, loss_unit=1.0)
    return last


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


@pytest.mark.parametrize("changes", [{}, {"linear": True, "weight_decay": 0.1}, {"horizon": 3}], ids=str)
def test_an_ensemble_has_the_same_bytes_with_one_two_and_four_workers(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any]
) -> None:
    """Its bins too: `bins/changed` is among the metrics of every epoch, and networks depend on them."""
    here = threading.local()
    monkeypatch.setattr(sharing.Shares, "here", staticmethod(lambda _: here.own))
    alone = trained(Shares(4), here, **changes)
    for workers in (1, 2, 4):
        for last in together(workers, 4, lambda own: trained(own, here, **changes)):
            assert weights(last) == weights(alone)
            assert last.metrics == alone.metrics


def test_shares_change_an_epoch_by_rounding_alone() -> None:
    """Stated tolerance: 1e-5 of the weights' size after the first epoch; later ones part as rounding grows."""
    first = [
        next(train_ensemble(TRAIN, VALIDATION, ENSEMBLE.model_copy(update={"shares": n}), seed=0, loss_unit=1.0))
        for n in (1, 4)
    ]
    for one, four in zip(*(epoch.network.parameters() for epoch in first), strict=True):
        assert (one - four).abs().max() <= 1e-5 * one.abs().max()


def test_shares_that_workers_cannot_divide_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sharing.dist, "is_initialized", lambda: True)
    monkeypatch.setattr(sharing.dist, "get_world_size", lambda: 3)
    with pytest.raises(TrainingError, match=r"ensemble\.shares is 4, which 3 workers cannot divide"):
        Shares.here(4)
