"""The settings of a recipe for motion as a person reads them."""

from __future__ import annotations

from addressed_dynamics.reporting.common.numbers import listed, percent
from addressed_dynamics.reporting.common.origin import ModelWords
from addressed_dynamics.sources.motion.params import AugmentationParams, MotionFeatureParams

TARGETS = {
    "absolute": "the outputs themselves",
    "change": "what the outputs add to persistence",
    "trajectory_change": "the joints themselves, and what the trajectory adds to persistence",
}
"""What networks are asked for."""


def model_words(features: MotionFeatureParams, mode: str) -> ModelWords:
    """Return what a report says of networks with these features.

    Args:
        features: what they are given and asked for.
        mode: how the delivered model uses the outputs of the addressing network.
    """
    given = {
        "Inputs": f"342, of one frame and the trajectory around it, without the phase{_weight(features)}",
        "Augmentation": _augmentation(features.augmentation),
    }
    return ModelWords(given=given, predicted=TARGETS[features.target], mode=mode)


def _weight(features: MotionFeatureParams) -> str:
    weight = features.joint_input_weight
    return "" if weight == 1 else f"; those of the joints count {weight:g} times"


def _augmentation(augmentation: AugmentationParams) -> str:
    parts = []
    if augmentation.pose_noise:
        parts.append(f"noise of {augmentation.pose_noise:g} deviations on the joints")
    if augmentation.pose_mix:
        parts.append(f"up to {percent(augmentation.pose_mix, 0)} of another frame's joints mixed in")
    if augmentation.gait_swap:
        parts.append(f"another frame's gaits for {percent(augmentation.gait_swap, 0)} of the samples")
    return f"of the inputs in training: {listed(parts)}" if parts else "none"
