"""Dropout and augmentation in the training of ensembles and addressing networks: on frames of motion."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from motions import make_motion
from torch import Tensor

from addressed_dynamics.base.params.sections import OptimiserParams
from addressed_dynamics.base.params.training import AddressingTraining, EnsembleParams
from addressed_dynamics.features.motion.augmentation import MotionAugmentation
from addressed_dynamics.features.motion.features import fit_motion_features
from addressed_dynamics.sources.motion.params import AugmentationParams, MotionFeatureParams
from addressed_dynamics.training.addressing import train_addressing
from addressed_dynamics.training.checkpoints import Checkpoint
from addressed_dynamics.training.ensemble import evaluate_profiles, train_ensemble
from addressed_dynamics.training.epochs import Epoch

FEATURES = fit_motion_features(make_motion(), MotionFeatureParams(target="trajectory_change"))
TRAIN, VALIDATION = FEATURES.samples(make_motion()), FEATURES.samples(make_motion(24, seed=1))
AUGMENT = MotionAugmentation(FEATURES, TRAIN.x, AugmentationParams(pose_mix=0.2, pose_shrink=0.5))
OPTIMISER = OptimiserParams(learning_rate=1e-3, betas=(0.9, 0.999), final_share=0.0)
ENSEMBLE = EnsembleParams(
    seeds=(0,), members=2, hidden=(16,), activation="elu", loss="mse", optimiser=OPTIMISER, batch_size=16, epochs=4,
    cluster_epochs=2,
)  # fmt: skip
ADDRESSING = AddressingTraining(
    hidden=(8,), heads=(), activation="elu", optimiser=OPTIMISER, batch_size=16, epochs=4, tie_share=1.0
)


def ensemble(dropout: float = 0.0, **options: Any) -> Iterator[Epoch]:
    params = ENSEMBLE.model_copy(update={"dropout": dropout})
    return train_ensemble(TRAIN, VALIDATION, params, seed=0, loss_unit=1.0, **options)


def addressing(dropout: float = 0.0, **options: Any) -> Iterator[Epoch]:
    *_, last = ensemble()
    profiles = [evaluate_profiles(last.network, samples, "mse") for samples in (TRAIN, VALIDATION)]
    params = ADDRESSING.model_copy(update={"dropout": dropout})
    return train_addressing(
        TRAIN, profiles[0], VALIDATION, profiles[1], params, seed=0, variant="plain", **options
    )  # fmt: skip


def weights(epochs: Iterator[Epoch]) -> Tensor:
    *_, last = epochs
    return torch.cat([parameter.detach().flatten() for parameter in last.network.parameters()])


TRAININGS = pytest.mark.parametrize("train", [ensemble, addressing])
OPTIONS = pytest.mark.parametrize(
    "options", [{"dropout": 0.2}, {"augment": AUGMENT}, {"dropout": 0.2, "augment": AUGMENT}]
)


@TRAININGS
@OPTIONS
def test_it_changes_what_is_learned_but_not_that_a_seed_repeats(train: Any, options: dict[str, Any]) -> None:
    first = weights(train(**options))
    assert torch.equal(first, weights(train(**options)))
    assert not torch.equal(first, weights(train()))


@TRAININGS
def test_an_augmentation_that_does_nothing_changes_nothing(train: Any) -> None:
    nothing = MotionAugmentation(FEATURES, TRAIN.x, AugmentationParams(pose_noise=0.0, pose_shrink=0.0, gait_swap=0.0))
    assert torch.equal(weights(train(augment=nothing)), weights(train()))


@TRAININGS
def test_a_training_that_is_cut_off_goes_on_bit_for_bit(train: Any, tmp_path: Path) -> None:
    options = {"dropout": 0.2, "augment": AUGMENT}
    interrupted = train(**options, checkpoint=Checkpoint(tmp_path / "state"))
    assert [next(interrupted).index for _ in range(2)] == [1, 2]
    interrupted.close()
    resumed = weights(train(**options, checkpoint=Checkpoint(tmp_path / "state")))
    assert torch.equal(resumed, weights(train(**options)))
