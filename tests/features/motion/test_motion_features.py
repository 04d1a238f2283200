"""MotionFeatures: PFNN's normalisation with a floor, targets there and back, and its JSON."""

import json

import numpy as np
import pytest
import torch
from motions import make_motion
from pfnn_data import PFNN_DATA, needs_pfnn_data

from addressed_dynamics.base.errors import ModelError, MotionError
from addressed_dynamics.episodes.layout import INPUT, INPUT_GAITS, INPUT_HEIGHTS, NOW, OUTPUT
from addressed_dynamics.features.motion.features import MotionFeatures, fit_motion_features, persistence
from addressed_dynamics.sources.motion.params import MotionFeatureParams

TARGETS = pytest.mark.parametrize("target", ["absolute", "change", "trajectory_change"])


def fitted(target: str = "absolute", weight: float = 0.1) -> MotionFeatures:
    params = MotionFeatureParams(target=target, joint_input_weight=weight)  # type: ignore[arg-type] # from a parametrisation
    return fit_motion_features(make_motion(), params)


@TARGETS
def test_decoding_an_encoded_target_gives_the_outputs_back(target: str) -> None:
    motion, features = make_motion(seed=1), fitted(target)
    x, y = torch.from_numpy(motion.x), torch.from_numpy(motion.y)
    torch.testing.assert_close(features.decode(features.encode_target(x, y), x), y, atol=1e-4, rtol=1e-5)


@TARGETS
def test_outputs_of_several_members_are_decoded_each(target: str) -> None:
    features, x = fitted(target), torch.from_numpy(make_motion().x)
    output = torch.randn(3, len(x), OUTPUT.width, generator=torch.Generator().manual_seed(0))
    decoded = features.decode(output, x)
    for member in range(3):
        torch.testing.assert_close(decoded[member], features.decode(output[member], x))


def test_the_columns_of_a_group_share_one_deviation() -> None:
    features = fitted()
    deviation = np.array(features.input_deviation)
    for columns in (INPUT_GAITS, INPUT_HEIGHTS, INPUT.joint_position, INPUT.trajectory_position_x):
        assert len(np.unique(deviation[columns])) == 1
    assert deviation[INPUT.trajectory_position_x][0] != deviation[INPUT.trajectory_position_z][0]
    target = np.array(features.target_deviation)
    assert target[OUTPUT.trajectory_position_x][0] == target[OUTPUT.trajectory_position_z][0]


def test_inputs_have_mean_zero_and_deviation_one_but_joints_are_small() -> None:
    x = fitted(weight=0.25).samples(make_motion()).x
    torch.testing.assert_close(x.mean(dim=0), torch.zeros(INPUT.width), atol=1e-5, rtol=0)
    deviation = x.std(dim=0, correction=0)
    assert deviation[INPUT.trajectory_position_x].mean() == pytest.approx(1.0, abs=1e-5)
    assert deviation[INPUT.joint_position].mean() == pytest.approx(0.25, abs=1e-5)
    assert deviation[INPUT.joint_velocity].mean() == pytest.approx(0.25, abs=1e-5)


def test_a_slope_after_training_on_flat_ground_alone_stays_a_small_input() -> None:
    features, x = fitted(), torch.from_numpy(make_motion().x).clone()
    x[:, INPUT_HEIGHTS] = 30.0
    assert features.encode(x)[:, INPUT_HEIGHTS].abs().max() <= 30.0


def test_samples_are_in_the_order_of_the_frames() -> None:
    motion = make_motion(rows=10, clips=("b", "a"))
    samples = fitted().samples(motion)
    assert samples.step.tolist() == [*range(10), *range(10)]
    assert samples.episode.tolist() == [1] * 10 + [0] * 10


def test_persistence_moves_joints_by_their_velocity_less_the_roots() -> None:
    x = torch.zeros(1, INPUT.width)
    x[0, INPUT.trajectory_position_z] = 2.0 * torch.arange(-60, 60, 10)  # 2 cm a frame straight on
    x[0, INPUT.joint_position] = torch.tensor([1.0, 2.0, 3.0]).repeat(31)
    x[0, INPUT.joint_velocity] = torch.tensor([0.5, 0.25, 2.0]).repeat(31)
    y = persistence(x)
    torch.testing.assert_close(y[0, OUTPUT.joint_position], torch.tensor([1.5, 2.25, 3.0]).repeat(31))
    torch.testing.assert_close(y[0, OUTPUT.joint_velocity], x[0, INPUT.joint_velocity])
    torch.testing.assert_close(y[0, OUTPUT.trajectory_position_z], x[0, INPUT.trajectory_position_z][NOW:])
    assert not y[0, OUTPUT.joint_rotation].any()


def test_a_change_of_trajectory_leaves_joints_absolute() -> None:
    motion = make_motion()
    x, y = torch.from_numpy(motion.x), torch.from_numpy(motion.y)
    mixed, absolute, change = (fitted(t).encode_target(x, y) for t in ("trajectory_change", "absolute", "change"))
    joints = OUTPUT.span("joint_position", "joint_rotation")
    assert torch.equal(mixed[:, joints], absolute[:, joints])
    torch.testing.assert_close(mixed[:, : joints.start], change[:, : joints.start])
    assert not torch.allclose(change[:, OUTPUT.joint_velocity], absolute[:, OUTPUT.joint_velocity])


@TARGETS
def test_features_survive_json(target: str) -> None:
    features = fitted(target)
    value = json.loads(json.dumps(features.to_json()))
    assert value["kind"] == "motion"
    assert MotionFeatures.from_json(value) == features


@pytest.mark.parametrize(("key", "value"), [("target", "both"), ("input_mean", [0.0]), ("target_deviation", None)])
def test_malformed_json_is_refused(key: str, value: object) -> None:
    with pytest.raises(ModelError, match="incomplete or malformed"):
        MotionFeatures.from_json({**fitted().to_json(), key: value})


def test_no_frames_are_refused() -> None:
    with pytest.raises(MotionError, match="no training frames"):
        fit_motion_features(make_motion().select(slice(0, 0)), MotionFeatureParams(target="absolute"))


def test_inputs_of_another_width_are_refused() -> None:
    with pytest.raises(ModelError, match=r"\(B, 342\), but have \(2, 5\)"):
        fitted().encode(torch.zeros(2, 5))


@needs_pfnn_data
def test_persistence_is_a_good_guess_on_real_clips() -> None:
    with np.load(PFNN_DATA / "database_flat.npz") as data:
        x, y = torch.from_numpy(data["Xun"]), torch.from_numpy(data["Yun"])
    error = (persistence(x) - y).abs().mean(dim=0)
    assert error[OUTPUT.joint_position].mean() < 0.3
    assert error[OUTPUT.joint_velocity].mean() < 0.15
