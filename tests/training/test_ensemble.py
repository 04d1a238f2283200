import math
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from learning import ENSEMBLE, car_samples

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.clustering import assign_to_bins
from addressed_dynamics.training.ensemble import (
    Binning,
    evaluate_profiles,
    specialisation,
    train_ensemble,
    untrained_ensemble,
)
from addressed_dynamics.training.epochs import Epoch
from addressed_dynamics.training.losses import reported_loss

FEATURES, TRAIN, VALIDATION = car_samples()
UNIT = FEATURES.loss_unit("mse")
BINNINGS: list[Binning] = ["equal", "lowest_loss", "random"]


def train(params: EnsembleParams = ENSEMBLE, *, seed: int = 3, **options: Any) -> Iterator[Epoch]:
    return train_ensemble(TRAIN, VALIDATION, params, seed=seed, loss_unit=UNIT, **options)


def weights(epoch: Epoch) -> bytes:
    return b"".join(parameter.detach().numpy().tobytes() for parameter in epoch.network.parameters())


def first_rows(samples: Samples, rows: int) -> Samples:
    return Samples(samples.x[:rows], samples.y[:rows], samples.episode[:rows], samples.step[:rows])


@pytest.mark.parametrize("binning", BINNINGS)
@pytest.mark.parametrize("loss", ["mse", "mae", "mae+mse"])
def test_training_lowers_the_loss_on_validation_episodes(binning: Binning, loss: str) -> None:
    params = ENSEMBLE.model_copy(update={"loss": loss, "epochs": 15})
    first, *_, last = train(params, binning=binning)
    assert last.metrics["loss/validation"] < 0.9 * first.metrics["loss/validation"]
    assert last.metrics["loss/train"] < 0.8 * first.metrics["loss/train"]


@pytest.mark.parametrize("binning", BINNINGS)
def test_the_same_seed_gives_the_same_bytes_and_metrics_and_another_seed_others(binning: Binning) -> None:
    (*_, first), (*_, again), (*_, other) = (train(seed=seed, binning=binning) for seed in (3, 3, 4))
    assert weights(first) == weights(again)
    assert first.metrics == again.metrics
    assert weights(first) != weights(other)


def test_it_neither_seeds_nor_uses_the_global_generator() -> None:
    before = torch.get_rng_state()
    list(train())
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("binning", BINNINGS)
@pytest.mark.parametrize("finished", [1, 4, 6], ids=lambda epochs: f"after {epochs}")
def test_a_training_that_is_cut_off_goes_on_bit_for_bit(tmp_path: Path, binning: Binning, finished: int) -> None:
    straight = list(train(binning=binning))
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    for _ in islice(train(binning=binning, checkpoint=checkpoint), finished):
        pass
    resumed = list(train(binning=binning, checkpoint=checkpoint))
    assert weights(resumed[-1]) == weights(straight[-1])
    shown = [[(e.index, e.last, e.updates, e.metrics) for e in epochs] for epochs in (resumed, straight)]
    assert shown[0] == shown[1]


def test_a_checkpoint_that_cannot_be_read_means_to_begin_again(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    checkpoint.path.write_bytes(b"damaged")
    (*_, last), (*_, expected) = train(checkpoint=checkpoint), train()
    assert weights(last) == weights(expected)


def test_a_checkpoint_belongs_to_one_training(tmp_path: Path) -> None:
    names = {Checkpoint.of(tmp_path, seed=seed, rate=rate).path for seed in (0, 1) for rate in (1e-3, 1e-4)}
    assert len(names) == 4
    assert Checkpoint.of(tmp_path, rate=1e-3, seed=0).path in names
    checkpoint = Checkpoint.of(tmp_path, seed=0)
    checkpoint.save([{"loss": 0.1}], {"state": torch.ones(2)})
    history, tensors = checkpoint.load()
    assert history == [{"loss": 0.1}]
    assert tensors["state"].tolist() == [1.0, 1.0]
    checkpoint.remove()
    assert checkpoint.load() == ([], {})
    checkpoint.remove()


def test_metrics_are_those_of_the_networks_as_they_are() -> None:
    *_, last = train()
    profiles = evaluate_profiles(last.network, VALIDATION, "mse").double() * UNIT
    best = profiles.argmin(dim=1)
    expected = {"loss/validation": profiles.min(dim=1).values.mean()}
    for member in range(2):
        expected[f"share/{member}"] = (best == member).double().mean()
        expected[f"selected/{member}"] = profiles[best == member, member].mean()
        expected[f"not_selected/{member}"] = profiles[best != member, member].mean()
    for name, value in expected.items():
        assert last.metrics[name] == pytest.approx(float(value), rel=1e-5), name
    losses = [last.metrics[f"loss_member/{member}"] for member in range(2)]
    assert last.metrics["loss/train"] == pytest.approx(sum(losses) / 2)


def test_epochs_are_numbered_and_count_their_updates() -> None:
    epochs = list(train())
    assert [epoch.index for epoch in epochs] == [1, 2, 3, 4, 5, 6]
    assert [epoch.last for epoch in epochs] == [False] * 5 + [True]
    per_epoch = math.ceil(math.ceil(len(TRAIN) / 2) / 8)
    assert [epoch.updates for epoch in epochs] == [per_epoch * epoch.index for epoch in epochs]


def test_bins_are_made_anew_only_while_clustering_goes_on() -> None:
    changed = [epoch.metrics["bins/changed"] for epoch in train()]
    assert changed[0] == 1.0
    assert all(share > 0.0 for share in changed[1:4])
    assert changed[4:] == [0.0, 0.0]


def test_random_bins_stay_as_they_are() -> None:
    assert [epoch.metrics["bins/changed"] for epoch in train(binning="random")][1:] == [0.0] * 5


def test_equal_bins_are_those_of_algorithm_1_on_the_profiles_before_the_epoch(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    fresh = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], ENSEMBLE, seed=3)
    expected = assign_to_bins(evaluate_profiles(fresh, TRAIN, "mse"))
    next(train(checkpoint=checkpoint))
    assert torch.equal(checkpoint.load()[1]["bins"], expected)


def test_profiles_equal_the_losses_of_every_member_on_its_own() -> None:
    stack = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], ENSEMBLE, seed=0)
    outputs = stack(TRAIN.x).detach()
    for loss, each in {
        "mse": (outputs - TRAIN.y).square(),
        "mae": (outputs - TRAIN.y).abs(),
        "mae+mse": (outputs - TRAIN.y).square() + (outputs - TRAIN.y).abs(),
    }.items():
        profiles = evaluate_profiles(stack, TRAIN, loss)
        assert profiles.shape == (len(TRAIN), 2)
        torch.testing.assert_close(profiles, each.mean(dim=2).T)


@settings(max_examples=50)
@given(st.integers(1, 40), st.integers(1, 5), st.integers(0, 1000))
def test_specialisation_equals_a_loop_over_the_samples(samples: int, members: int, seed: int) -> None:
    profiles = torch.rand(samples, members, generator=torch.Generator().manual_seed(seed))
    metrics = specialisation(profiles)
    rows = profiles.tolist()
    for member in range(members):
        own = [row[member] for row in rows if row.index(min(row)) == member]
        other = [row[member] for row in rows if row.index(min(row)) != member]
        assert metrics[f"share/{member}"] == pytest.approx(len(own) / samples)
        assert metrics.get(f"selected/{member}") == (pytest.approx(sum(own) / len(own)) if own else None)
        assert metrics.get(f"not_selected/{member}") == (pytest.approx(sum(other) / len(other)) if other else None)


def test_too_few_samples_are_refused() -> None:
    with pytest.raises(TrainingError, match="at least 2 training samples and one for validation, but has 1 and 60"):
        next(train_ensemble(first_rows(TRAIN, 1), VALIDATION, ENSEMBLE, seed=0, loss_unit=UNIT))
    with pytest.raises(TrainingError, match="has 200 and 0"):
        next(train_ensemble(TRAIN, first_rows(VALIDATION, 0), ENSEMBLE, seed=0, loss_unit=UNIT))


def test_as_many_samples_as_members_are_enough() -> None:
    *_, last = train_ensemble(first_rows(TRAIN, 2), VALIDATION, ENSEMBLE, seed=0, loss_unit=UNIT)
    assert last.updates == ENSEMBLE.epochs


def test_a_loss_that_is_not_finite_ends_training_with_advice() -> None:
    optimiser = ENSEMBLE.optimiser.model_copy(update={"learning_rate": 1e30})
    with pytest.raises(TrainingError, match=r"lower ensemble\.optimiser\.learning_rate"):
        list(train(ENSEMBLE.model_copy(update={"optimiser": optimiser}), binning="random"))


RESTARTED = ENSEMBLE.model_copy(update={"restart": True})


def test_a_restart_finds_the_bins_first_and_then_trains_untrained_networks_on_them(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    epochs = [(each.metrics, checkpoint.load()[1]["bins"]) for each in train(RESTARTED, checkpoint=checkpoint)]
    search = ENSEMBLE.model_copy(update={"epochs": ENSEMBLE.cluster_epochs})
    assert [metrics for metrics, _ in epochs[: search.epochs]] == [epoch.metrics for epoch in train(search)]
    found = epochs[search.epochs - 1][1]
    assert all(torch.equal(bins, found) for _, bins in epochs[search.epochs :])
    rates = [metrics["learning_rate"] for metrics, _ in epochs]
    assert rates[0] == rates[search.epochs] == ENSEMBLE.optimiser.learning_rate
    assert max(rates[1 : search.epochs] + rates[search.epochs + 1 :]) < rates[0]
    losses = [metrics["loss/train"] for metrics, _ in epochs]
    assert losses[search.epochs] > losses[search.epochs - 1]


@pytest.mark.parametrize("finished", range(1, RESTARTED.epochs))
def test_a_restarted_training_that_is_cut_off_goes_on_bit_for_bit(tmp_path: Path, finished: int) -> None:
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    expected = [(epoch.metrics, epoch.updates) for epoch in train(RESTARTED)]
    *_, last = train(RESTARTED)
    for _ in islice(train(RESTARTED, checkpoint=checkpoint), finished):
        pass
    resumed = [(epoch.metrics, epoch.updates, epoch.network) for epoch in train(RESTARTED, checkpoint=checkpoint)]
    assert [each[:2] for each in resumed] == expected
    for found, wanted in zip(resumed[-1][2].parameters(), last.network.parameters(), strict=True):
        assert torch.equal(found, wanted)


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("updates", [53, 60, 77])
def test_a_training_stops_after_exactly_so_many_updates_and_its_learning_rate_ends_with_them(
    tmp_path: Path, updates: int, restart: bool
) -> None:
    params = ENSEMBLE.model_copy(update={"restart": restart})
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    last = list(train(params, updates=updates, checkpoint=checkpoint))[-1]
    per_epoch = math.ceil(math.ceil(len(TRAIN) / 2) / 8)
    assert (last.index, last.last, last.updates) == (math.ceil(updates / per_epoch), True, updates)
    counted = updates - ENSEMBLE.cluster_epochs * per_epoch if restart else updates
    assert int(checkpoint.load()[1]["updates"]) == counted
    before = (last.updates - 1) // per_epoch * per_epoch - (updates - counted)
    share = 0.1 + 0.9 * 0.5 * (1 + math.cos(math.pi * before / counted))
    assert last.metrics["learning_rate"] == pytest.approx(1e-2 * share)
    for _ in islice(train(params, updates=updates, checkpoint=Checkpoint(tmp_path / "again")), last.index - 1):
        pass
    *_, resumed = train(params, updates=updates, checkpoint=Checkpoint(tmp_path / "again"))
    assert (weights(resumed), resumed.metrics, resumed.samples) == (weights(last), last.metrics, last.samples)


@pytest.mark.parametrize("restart", [False, True])
def test_as_many_updates_as_whole_epochs_have_give_the_bytes_of_a_training_by_epochs(restart: bool) -> None:
    params = ENSEMBLE.model_copy(update={"restart": restart})
    *_, expected = train(params)
    *_, last = train(params.model_copy(update={"epochs": 9}), updates=expected.updates)
    assert weights(last) == weights(expected)
    assert last.metrics == expected.metrics
    assert last.samples == expected.samples == 6 * len(TRAIN)


def test_updates_that_end_before_the_restart_are_refused() -> None:
    with pytest.raises(TrainingError, match="start again after 4 epochs, but 30 updates end before that: give more"):
        next(train(RESTARTED, updates=30))


@pytest.mark.parametrize("loss", ["mse", "mae", "mae+mse"])
def test_losses_in_training_and_in_validation_are_of_one_unit(loss: str) -> None:
    optimiser = ENSEMBLE.optimiser.model_copy(update={"learning_rate": 1e-30})
    still = ENSEMBLE.model_copy(update={"members": 1, "loss": loss, "optimiser": optimiser, "batch_size": 50})
    unit = FEATURES.loss_unit(reported_loss(loss))
    assert unit != pytest.approx(1.0)
    epoch = next(train_ensemble(TRAIN, TRAIN, still, seed=3, loss_unit=unit))
    assert epoch.metrics["loss/train"] == pytest.approx(epoch.metrics["loss/validation"], rel=1e-5)
    assert epoch.metrics["loss_member/0"] == epoch.metrics["loss/train"]


DRAWN = ENSEMBLE.model_copy(update={"temperature": 1.0, "cluster_epochs": 3, "overlap": 0.5})


@pytest.mark.parametrize("restart", [False, True])
@pytest.mark.parametrize("finished", [1, 3, 4])
def test_a_training_with_drawn_bins_and_overlap_goes_on_bit_for_bit(
    tmp_path: Path, finished: int, restart: bool
) -> None:
    params = DRAWN.model_copy(update={"restart": restart})
    *_, expected = train(params)
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    for _ in islice(train(params, checkpoint=checkpoint), finished):
        pass
    *_, resumed = train(params, checkpoint=checkpoint)
    assert weights(resumed) == weights(expected)
    assert resumed.metrics == expected.metrics


def test_drawn_bins_end_as_those_of_algorithm_1(tmp_path: Path) -> None:
    checkpoint = Checkpoint(tmp_path / "state.safetensors")
    epochs = train(DRAWN, checkpoint=checkpoint)
    first, second = (next(epochs) and checkpoint.load()[1]["bins"] for _ in range(2))
    stack = untrained_ensemble(TRAIN.x.shape[1], TRAIN.y.shape[1], DRAWN, seed=3)
    assert not torch.equal(first, assign_to_bins(evaluate_profiles(stack, TRAIN, "mse")))
    assert not torch.equal(first, second)
    kept = next(epochs) and checkpoint.load()[1]["bins"]
    counts = torch.bincount(kept, minlength=2)
    assert counts.max() - counts.min() <= 1
    assert torch.equal((next(epochs) and checkpoint.load()[1])["bins"], kept)


def test_overlap_begins_when_the_bins_are_kept_and_needs_bins_made_by_losses() -> None:
    overlapping, plain = ENSEMBLE.model_copy(update={"overlap": 0.5}), ENSEMBLE
    kept = ENSEMBLE.cluster_epochs
    for first, second in islice(zip(train(overlapping), train(plain), strict=True), kept):
        assert first.metrics == second.metrics
    *_, first = train(overlapping)
    *_, second = train(plain)
    assert weights(first) != weights(second)
    (*_, first), (*_, second) = (train(each, binning="random") for each in (overlapping, plain))
    assert weights(first) == weights(second)
