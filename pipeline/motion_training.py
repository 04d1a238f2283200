"""What models of motion are trained on."""

from dataclasses import dataclass, field

from torch import Tensor, from_numpy

from addressed_dynamics.base.params.motion import AugmentationParams, MotionFeatureParams
from addressed_dynamics.features.motion.augmentation import MotionAugmentation
from addressed_dynamics.features.motion.features import MotionFeatures, fit_motion_features
from addressed_dynamics.sources.motion.tables import load_motion
from pipeline.common import tables_dir
from pipeline.training import TrainingData


@dataclass(frozen=True)
class MotionTrainingData(TrainingData[MotionFeatures]):
    """The frames of an experiment as samples, with their phases."""

    train_phase: Tensor = field(kw_only=True)
    """Phase of each training sample, in [0, 1]."""
    validation_phase: Tensor = field(kw_only=True)
    """Phase of each validation sample."""


def load_motion_data(
    experiment: str, features: MotionFeatureParams | MotionFeatures, augmentation: AugmentationParams | None
) -> MotionTrainingData:
    """Read the training and validation samples of `experiment`, with features to be fitted or those of a model."""
    train = load_motion(tables_dir(experiment), "train")
    validation = load_motion(tables_dir(experiment), "validation")
    spec = features if isinstance(features, MotionFeatures) else fit_motion_features(train, features)
    samples = spec.samples(train)
    augment = None if augmentation is None else MotionAugmentation(spec, samples.x, augmentation)
    return MotionTrainingData(
        spec,
        samples,
        spec.samples(validation),
        augment,
        train_phase=from_numpy(train.phase),
        validation_phase=from_numpy(validation.phase),
    )
