"""What motion supplies to the trainings."""

from pathlib import Path

from torch import from_numpy

from addressed_dynamics.features.common.spool import Spool
from addressed_dynamics.features.common.training_data import TrainingData
from addressed_dynamics.features.motion.augmentation import MotionAugmentation
from addressed_dynamics.features.motion.features import MotionFeatures, fit_motion_features
from addressed_dynamics.sources.motion.params import MotionExperimentParams, MotionFeatureParams
from addressed_dynamics.sources.motion.tables import load_motion

FEATURES = MotionFeatures
"""What networks of this kind of data are saved with."""
PHASE_FEATURES = MotionFeatureParams(target="absolute", joint_input_weight=0.1)
"""What a phase-functioned network is given and asked for (Holden, Komura, Saito 2017, Section 6)."""


def load_training_data(
    tables: Path,
    sections: MotionExperimentParams,
    features: MotionFeatureParams | MotionFeatures,
    *,
    augmented: bool = True,
    spool: Spool | None = None,  # noqa: ARG001 - motion is trained on from memory
) -> TrainingData[MotionFeatures]:
    """Read the training and validation samples in `tables`, with features to be fitted or those of a model."""
    train, validation = load_motion(tables, "train"), load_motion(tables, "validation")
    spec = features if isinstance(features, MotionFeatures) else fit_motion_features(train, features)
    samples = spec.samples(train)
    augment = MotionAugmentation(spec, samples.x[:], sections.features.augmentation) if augmented else None
    phases = from_numpy(train.phase), from_numpy(validation.phase)
    return TrainingData(spec, samples, spec.samples(validation), augment, phases)
