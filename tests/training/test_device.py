"""Trainings on a device: what comes out, and that updates wait for nothing. Where there is no GPU, one is pretended."""

from collections.abc import Callable, Iterator
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import pytest
import torch
from learning import ADDRESSING, ENSEMBLE, car_samples, drive
from motions import make_motion
from pretended_gpu import GPU, GPUS, gpu, pretended_gpu

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import BlendedTraining
from addressed_dynamics.base.torch_runtime import CPU
from addressed_dynamics.features.motion.augmentation import MotionAugmentation
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.networks.stacked import StackedMLP
from addressed_dynamics.sources.motion.params import AugmentationParams, MotionFeatureParams
from addressed_dynamics.sources.transitions.params import FeatureParams
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.blended import train_gated, train_phase_functioned
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.clustering import assign_to_bins, draw_bins
from addressed_dynamics.training.ensemble import profiles_on, train_ensemble
from addressed_dynamics.training.epochs import Epoch

FEATURES, TRAIN, VALIDATION = car_samples()
HISTORY = fit_features(drive((20,) * 10), FeatureParams(target="change", history=3))
WINDOWS = [HISTORY.samples(each, courses=True) for each in (drive((20,) * 10), drive((15,) * 4, seed=1))]
MOTION, OTHER = make_motion(), make_motion(24, seed=1)
FRAMES = fit_motion_features(MOTION, MotionFeatureParams(target="change"))
AUGMENT = MotionAugmentation(
    FRAMES,
    FRAMES.samples(MOTION).x[:],
    AugmentationParams(pose_noise=0.1, pose_mix=0.1, pose_shrink=0.1, gait_swap=0.1),
)
BLENDED = BlendedTraining(
    hidden=(8,), gate_hidden=(8,), members=3, activation="elu", loss="mse", dropout=0.2, batch_size=16, epochs=2,
    optimiser=OptimiserParams(learning_rate=3e-3, betas=(0.9, 0.999), final_share=1.0),
)  # fmt: skip

Training = Callable[..., Iterator[Epoch]]


def ensemble(**changes: Any) -> Training:
    recipe = ENSEMBLE.model_copy(update={"epochs": 3, "cluster_epochs": 2, **changes})
    train, validation = WINDOWS if recipe.horizon > 1 else (TRAIN, VALIDATION)
    return partial(train_ensemble, train, validation, recipe, seed=3, loss_unit=1.0)


def addressing(**changes: Any) -> Training:
    generator = torch.Generator().manual_seed(0)
    profiles = [torch.rand(len(part), 3, generator=generator) for part in (TRAIN, VALIDATION)]
    recipe = ADDRESSING.model_copy(update={"epochs": 3, **changes})
    return partial(train_addressing, TRAIN, profiles[0], VALIDATION, profiles[1], recipe, seed=3,
                   variant="cost_sensitive")  # fmt: skip


def blended(kind: str, **changes: Any) -> Training:
    recipe = BLENDED.model_copy(update=changes)
    train, validation = FRAMES.samples(MOTION), FRAMES.samples(OTHER)
    if kind == "gate":
        return partial(train_gated, train, validation, recipe, seed=0, augment=AUGMENT)
    phases = torch.from_numpy(MOTION.phase), torch.from_numpy(OTHER.phase)
    return partial(train_phase_functioned, train, phases[0], validation, phases[1], recipe, seed=0)


def augmented(**changes: Any) -> Training:
    recipe = ENSEMBLE.model_copy(update={"epochs": 2, "cluster_epochs": 1, **changes})
    samples = FRAMES.samples(MOTION), FRAMES.samples(OTHER)
    return partial(train_ensemble, *samples, recipe, seed=3, loss_unit=1.0, augment=AUGMENT)


TRAININGS: dict[str, Callable[..., Training]] = {
    "ensemble": ensemble,
    "ensemble, tanh": partial(ensemble, activation="tanh", loss="mae+mse"),
    "ensemble, dropout and decay": partial(ensemble, dropout=0.2, weight_decay=0.1, overlap=0.3),
    "ensemble, drawn bins": partial(ensemble, temperature=0.5),
    "ensemble, restart and early stopping": partial(ensemble, restart=True, early_stopping=1, epochs=6),
    "ensemble, linear": partial(ensemble, linear=True, members=3),
    "ensemble, shares": partial(ensemble, shares=4),
    "ensemble, horizon": partial(ensemble, horizon=3, linear=True),
    "ensemble, horizon and shares": partial(ensemble, horizon=3, shares=2),
    "ensemble, augmented": augmented,
    "addressing": addressing,
    "addressing, heads": partial(addressing, heads=(8,), activation="tanh", dropout=0.1),
    "gate": partial(blended, "gate"),
    "phase": partial(blended, "phase"),
}


def assert_alike(one: Epoch, other: Epoch) -> None:
    """Rounding grows while training goes on: of networks that are trained so briefly it stays below a thousandth."""
    networks = [(one.network, other.network), (getattr(one, "gate", None), getattr(other, "gate", None))]
    for here, there in networks:
        for mine, theirs in zip([] if here is None else here.parameters(), [] if there is None else there.parameters(),
                                strict=True):  # fmt: skip
            assert mine.device == theirs.device == CPU
            torch.testing.assert_close(mine, theirs, rtol=1e-3, atol=1e-4)
    assert one.metrics == pytest.approx(other.metrics, rel=1e-3, abs=1e-6)


@GPUS
@pytest.mark.parametrize("name", TRAININGS)
def test_a_training_ends_as_on_the_cpu_up_to_rounding(name: str, kind: str) -> None:
    training = TRAININGS[name]()
    *_, wanted = training(device=CPU)
    with gpu(kind) as device:
        *_, found = training(device=device)
    assert_alike(found, wanted)


@pytest.mark.parametrize("name", TRAININGS)
def test_the_processor_waits_for_the_device_once_an_epoch_and_not_for_updates(name: str) -> None:
    waits = []
    for batch_size in (16, 48):
        # Epochs that are not the first: samples are sent once, and shapes are seen.
        with pretended_gpu() as pretended:
            epochs = TRAININGS[name](batch_size=batch_size)(device=GPU)
            next(epochs)
            before = pretended.waits
            next(epochs)
            waits.append(pretended.waits - before)
    assert waits[0] == waits[1]


@pytest.mark.parametrize("name", ["ensemble", "ensemble, horizon", "addressing, heads", "phase"])
def test_an_update_that_has_been_made_twice_is_a_single_launch_beside_its_batch(name: str) -> None:
    per_update = []
    for batch_size in (4, 8):
        with pretended_gpu() as pretended:
            epochs = TRAININGS[name](batch_size=batch_size, epochs=4)(device=GPU)
            third = list(islice(epochs, 3))[-1]
            before = pretended.launches
            fourth = next(epochs)
            per_update.append((fourth.updates - third.updates, pretended.launches - before))
    (many, launches), (few, fewer) = per_update
    assert (launches - fewer) / (many - few) < 25


@GPUS
@pytest.mark.parametrize("name", ["ensemble", "addressing", "gate"])
def test_a_checkpoint_of_one_device_goes_on_on_another(tmp_path: Path, name: str, kind: str) -> None:
    training = TRAININGS[name](epochs=4)
    *_, wanted = training()
    for first in ("cpu", "gpu"):
        checkpoint = Checkpoint(tmp_path / f"{first}.safetensors")
        with gpu(kind) as device:
            devices = [CPU, device] if first == "cpu" else [device, CPU]
            list(islice(training(checkpoint=checkpoint, device=devices[0]), 2))
            *_, found = training(checkpoint=checkpoint, device=devices[1])
        assert_alike(found, wanted)


@GPUS
@pytest.mark.parametrize("name", ["ensemble, dropout and decay", "ensemble, horizon", "addressing, heads"])
def test_training_twice_on_one_device_gives_the_same_bytes(name: str, kind: str) -> None:
    with gpu(kind) as device:
        first, second = ([*TRAININGS[name]()(device=device)][-1] for _ in range(2))
    assert first.metrics == second.metrics
    for mine, theirs in zip(first.network.parameters(), second.network.parameters(), strict=True):
        assert torch.equal(mine, theirs)


@GPUS
@pytest.mark.parametrize("decimals", [1, 8])
def test_algorithm_1_gives_the_same_bins_as_on_the_cpu_ties_included(decimals: int, kind: str) -> None:
    generator = torch.Generator().manual_seed(0)
    losses = torch.rand(1000, 5, generator=generator).round(decimals=decimals)
    with gpu(kind) as device:
        there = losses.to(device)
        assert torch.equal(assign_to_bins(there).cpu(), assign_to_bins(losses))
        assert torch.equal(assign_to_bins(there, 0.3).cpu(), assign_to_bins(losses, 0.3))
        drawn = draw_bins(there, 0.5, torch.Generator().manual_seed(0)).cpu()
    assert torch.equal(drawn, draw_bins(losses, 0.5, torch.Generator().manual_seed(0)))


@GPUS
def test_profiles_are_those_of_the_cpu_up_to_rounding(kind: str) -> None:
    stack = StackedMLP(3, (5, 8, 2), "elu", torch.Generator().manual_seed(0))
    with gpu(kind) as device:
        found = profiles_on(device, stack, TRAIN, "mse")
    torch.testing.assert_close(found, profiles_on(CPU, stack, TRAIN, "mse"), rtol=1e-4, atol=1e-7)
