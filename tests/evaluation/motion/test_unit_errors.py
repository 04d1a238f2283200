"""Errors of motion in cm, cm/s and degrees."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from test_motion_one_step import ONES, random_motion

from addressed_dynamics.episodes.layout import JOINTS, OUTPUT
from addressed_dynamics.evaluation.motion.one_step import CHUNK_ROWS, one_step_errors
from addressed_dynamics.evaluation.motion.unit_errors import UNITS, unit_errors


def still() -> np.ndarray:
    """Two frames of somebody who faces ahead."""
    values = np.zeros((2, OUTPUT.width))
    values[:, OUTPUT.trajectory_direction_z] = 1.0
    return values


def errors(predicted: np.ndarray) -> dict[str, list[float]]:
    return {name: each.tolist() for name, each in unit_errors(predicted, still()).items()}


def test_no_error_is_none_in_any_unit() -> None:
    assert errors(still()) == {name: [0.0, 0.0] for name in UNITS}


@pytest.mark.parametrize(
    ("name", "block", "changes", "expected"),
    [
        ("root_velocity", "root_velocity", [0.3, 0.4], 60 * 0.5),
        ("root_turn", "root_turn", [-np.pi / 180], 60.0),
        ("phase_change", "phase_change", [0.02], 1.2),
        ("contact", "contact", [0.6, 0.4, 1.0, 0.0], 50.0),
        ("trajectory_position", "trajectory_position_z", [-6.0] * 6, 6.0),
        ("joint_position", "joint_position", [2.0, -1.0, 2.0] * len(JOINTS), 3.0),
        ("joint_velocity", "joint_velocity", [0.0, 0.1, 0.0] * len(JOINTS), 6.0),
        # Logarithms of quaternions are half of the angle.
        ("joint_rotation", "joint_rotation", [0.0, np.pi / 12, 0.0] * len(JOINTS), 30.0),
    ],
)
def test_each_error_is_in_its_unit_and_of_its_block_alone(
    name: str, block: str, changes: list[float], expected: float
) -> None:
    predicted = still()
    predicted[1, OUTPUT[block]] += changes
    found = errors(predicted)
    assert found.pop(name) == pytest.approx([0.0, expected])
    assert found == {name: [0.0, 0.0] for name in found}


def test_a_heading_is_off_by_the_angle_whatever_the_length_of_the_arrow() -> None:
    predicted = still()
    predicted[0, OUTPUT.trajectory_direction_x], predicted[0, OUTPUT.trajectory_direction_z] = 3.0, 3.0
    predicted[1, OUTPUT.trajectory_direction_z] = -0.2
    assert errors(predicted)["trajectory_direction"] == pytest.approx([45.0, 180.0])


@given(st.integers(0, 2**31 - 1))
def test_rotations_are_off_by_the_angle_between_two_orientations(seed: int) -> None:
    generator = np.random.default_rng(seed)
    predicted, true = generator.normal(0.0, 0.7, (2, 3, OUTPUT.width))
    found = unit_errors(predicted, true)["joint_rotation"]
    first, second = (
        Rotation.from_rotvec(2 * each[:, OUTPUT.joint_rotation].reshape(-1, 3)) for each in (predicted, true)
    )
    expected = np.degrees((first.inv() * second).magnitude()).reshape(3, -1).mean(axis=1)
    np.testing.assert_allclose(found, expected, atol=1e-5)


def test_the_errors_of_a_model_are_means_over_all_frames() -> None:
    motion = random_motion(CHUNK_ROWS + 7)

    def predictor(x: torch.Tensor, phase: torch.Tensor) -> torch.Tensor:
        assert len(x) == len(phase)
        return torch.full((len(x), OUTPUT.width), 0.25)

    found = one_step_errors(predictor, motion, ONES)
    each = unit_errors(np.full_like(motion.y, 0.25, dtype=np.float64), motion.y.astype(np.float64))
    assert {error.name: error.unit for error in found.units} == UNITS
    assert {error.name: error.value for error in found.units} == pytest.approx(
        {name: values.mean() for name, values in each.items()}
    )
    distances = {"joint_position": 1.0, "joint_velocity": 60.0}
    for name, times in distances.items():
        of_joints = np.mean([getattr(joint, name.removeprefix("joint_")) for joint in found.joints])
        assert {error.name: error.value for error in found.units}[name] == pytest.approx(times * of_joints)
