import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.episodes.layout import JOINTS
from addressed_dynamics.sources.motion.kinematics import facing, forward_kinematics, in_root, joint_rotations, smooth
from addressed_dynamics.sources.motion.quaternions import about, rotate


def test_an_arm_bends_where_its_joints_turn() -> None:
    # A root with two limbs of length 1 and 2 along x; frame 0 is straight, frame 1 bends by a right angle at the
    # shoulder, frame 2 at the shoulder and, the other way, at the elbow.
    positions = np.tile([[5.0, 0, 0], [0, 3, 0], [1, 0, 0], [2, 0, 0]], (3, 1, 1))
    angles = np.zeros((3, 4, 3))
    angles[1:, 1, 2] = 90
    angles[2, 2, 2] = -90
    placed, turned = forward_kinematics(positions, joint_rotations(angles, ("zyx",) * 4), (-1, 0, 1, 2))
    np.testing.assert_allclose(placed[0], [[5, 0, 0], [5, 3, 0], [6, 3, 0], [8, 3, 0]], atol=1e-15)
    np.testing.assert_allclose(placed[1], [[5, 0, 0], [5, 3, 0], [5, 4, 0], [5, 6, 0]], atol=1e-15)
    np.testing.assert_allclose(placed[2], [[5, 0, 0], [5, 3, 0], [5, 4, 0], [7, 4, 0]], atol=1e-15)
    np.testing.assert_allclose(turned[2, 2:], [[1, 0, 0, 0]] * 2, atol=1e-15)


def test_a_root_that_turns_carries_what_hangs_on_it() -> None:
    positions = np.array([[[1.0, 2, 3], [0, 0, 1]]])
    angles = np.array([[[0.0, 90, 0], [0, 0, 0]]])
    placed, _ = forward_kinematics(positions, joint_rotations(angles, ("zyx", "xyz")), (-1, 0))
    np.testing.assert_allclose(placed[0], [[1, 2, 3], [2, 2, 3]], atol=1e-15)


def test_each_joint_turns_in_its_own_order() -> None:
    angles = np.tile([90.0, 90, 0], (1, 2, 1))
    rotations = joint_rotations(angles, ("xyz", "yxz"))
    # About y first, z goes to x, where a turn about x leaves it; about x first, z goes to -y, where y leaves it.
    np.testing.assert_allclose(
        rotate(rotations, np.tile([0.0, 0, 1], (1, 2, 1))), [[[1, 0, 0], [0, -1, 0]]], atol=1e-15
    )


@given(seed=st.integers(0, 2**32 - 1), rows=st.integers(1, 30), deviation=st.sampled_from([0.5, 2.0, 3.3]))
def test_smoothing_agrees_with_a_naive_gaussian(seed: int, rows: int, deviation: float) -> None:
    values = np.random.default_rng(seed).normal(size=(rows, 2))
    reach = int(4 * deviation + 0.5)
    expected = np.empty_like(values)
    for row in range(rows):
        weights = {shift: np.exp(-0.5 * (shift / deviation) ** 2) for shift in range(-reach, reach + 1)}
        total = sum(weight * values[min(max(row + shift, 0), rows - 1)] for shift, weight in weights.items())
        expected[row] = total / sum(weights.values())
    np.testing.assert_allclose(smooth(values, deviation), expected, atol=1e-12)


@pytest.mark.parametrize(("degrees", "direction"), [(0, [0, 0, 1]), (90, [1, 0, 0]), (180, [0, 0, -1])])
def test_a_character_faces_to_the_front_of_its_shoulders_and_hips(degrees: float, direction: list[float]) -> None:
    positions = np.zeros((3, len(JOINTS), 3))
    for left, right, width in (("LeftArm", "RightArm", 20), ("LeftUpLeg", "RightUpLeg", 8)):
        positions[:, JOINTS.index(left), 0], positions[:, JOINTS.index(right), 0] = width, -width
    positions[:, JOINTS.index("LeftArm"), 1] = 5
    turned = rotate(about(1, np.full(positions.shape[:2], np.radians(degrees))), positions)
    np.testing.assert_allclose(facing(turned), [direction] * 3, atol=1e-12)


def test_what_a_character_faces_lies_ahead_in_the_frame_of_its_root() -> None:
    ahead = np.array([0.6, 0, -0.8])
    np.testing.assert_allclose(in_root(ahead, ahead), [0, 0, 1], atol=1e-15)
    np.testing.assert_allclose(in_root(np.array([-0.8, 7.0, -0.6]), ahead), [1, 7, 0], atol=1e-15)
