"""MotionAugmentation: what it changes, what it leaves, and that the outputs asked for stay the same."""

import pytest
import torch
from motions import make_motion
from torch import Tensor

from addressed_dynamics.episodes.layout import INPUT, INPUT_GAITS, INPUT_HEIGHTS
from addressed_dynamics.features.common.samples import Samples
from addressed_dynamics.features.motion.augmentation import JOINTS, MotionAugmentation
from addressed_dynamics.features.motion.features import MotionFeatures, fit_motion_features
from addressed_dynamics.sources.motion.params import AugmentationParams, MotionFeatureParams

MOTION = make_motion()
COMMANDS = [INPUT.span("trajectory_position_x", "trajectory_direction_z"), INPUT_HEIGHTS]


def augmented(target: str = "absolute", **params: float) -> tuple[MotionFeatures, Samples, Tensor, Tensor]:
    features = fit_motion_features(MOTION, MotionFeatureParams(target=target))  # type: ignore[arg-type] # from a parametrisation
    samples = features.samples(MOTION)
    settings = {"pose_noise": 0.0, "pose_mix": 0.0, "pose_shrink": 0.0, "gait_swap": 0.0, **params}
    augment = MotionAugmentation(features, samples.x, AugmentationParams(**settings))
    x, y = augment(samples.x, samples.y, torch.Generator().manual_seed(0))
    return features, samples, x, y


@pytest.mark.parametrize("target", ["absolute", "change", "trajectory_change"])
def test_inputs_that_are_off_ask_for_the_same_outputs(target: str) -> None:
    features, samples, x, y = augmented(target, pose_noise=0.3, pose_mix=0.5, pose_shrink=0.5, gait_swap=0.5)
    raw = x / features._constants.input_scale + features._constants.input_mean
    torch.testing.assert_close(features.decode(y, raw), torch.from_numpy(MOTION.y), atol=1e-3, rtol=1e-4)
    assert not torch.allclose(x, samples.x)


def test_without_anything_to_do_inputs_stay_as_they_are() -> None:
    _, samples, x, y = augmented()
    assert torch.equal(x, samples.x)
    assert torch.equal(y, samples.y)


def test_trajectory_and_terrain_are_left_alone() -> None:
    _, samples, x, _ = augmented(pose_noise=0.3, pose_mix=0.5, gait_swap=0.5)
    for columns in COMMANDS:
        assert torch.equal(x[:, columns], samples.x[:, columns])


def test_noise_has_the_size_of_the_joints_inputs() -> None:
    features, samples, x, _ = augmented(pose_noise=0.3)
    deviation = (x - samples.x)[:, JOINTS].std()
    assert float(deviation) == pytest.approx(0.3 * features.joint_input_weight, rel=0.02)
    assert torch.equal(x[:, INPUT_GAITS], samples.x[:, INPUT_GAITS])


def test_mixed_poses_lie_between_two_frames_poses() -> None:
    _, samples, x, _ = augmented(pose_mix=1.0)
    for row in range(0, len(x), 7):
        here, there = samples.x[row, JOINTS], x[row, JOINTS]
        lines = samples.x[:, JOINTS] - here
        share = (lines @ (there - here)) / (lines * lines).sum(dim=1).clamp(min=1e-9)
        distance = (here + share.unsqueeze(1) * lines - there).norm(dim=1)
        other = int(distance.argmin())
        assert float(distance[other]) < 1e-4
        assert 0.0 <= float(share[other]) <= 1.0


def test_shrunk_poses_keep_their_direction_from_the_mean_pose() -> None:
    _, samples, x, _ = augmented(pose_shrink=0.6)
    share = x[:, JOINTS].norm(dim=1) / samples.x[:, JOINTS].norm(dim=1)
    torch.testing.assert_close(x[:, JOINTS], share.unsqueeze(1) * samples.x[:, JOINTS])
    assert float(share.min()) == pytest.approx(0.4, abs=0.05)
    assert float(share.max()) == pytest.approx(1.0, abs=0.05)


def test_swapped_gaits_are_those_of_some_frame_and_as_many_as_asked_for() -> None:
    _, samples, x, _ = augmented(gait_swap=0.25)
    changed = (x[:, INPUT_GAITS] != samples.x[:, INPUT_GAITS]).any(dim=1)
    assert float(changed.double().mean()) == pytest.approx(0.25, abs=0.1)
    for row in torch.nonzero(changed).squeeze(1).tolist():
        assert (x[row, INPUT_GAITS] == samples.x[:, INPUT_GAITS]).all(dim=1).any()
