import numpy as np
import pytest

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import INPUT, INPUT_GAITS, INPUT_HEIGHTS, JOINTS, NOW, OFFSETS, OUTPUT, PARENTS
from addressed_dynamics.episodes.motion import Motion


def test_blocks_lie_where_the_published_layout_has_them() -> None:
    assert (INPUT.width, OUTPUT.width) == (342, 311)
    assert (INPUT.trajectory_position_z, INPUT_GAITS, INPUT.joint_position, INPUT.joint_velocity, INPUT_HEIGHTS) == (
        slice(12, 24), slice(48, 120), slice(120, 213), slice(213, 306), slice(306, 342),
    )  # fmt: skip
    assert (OUTPUT.root_turn, OUTPUT.contact, OUTPUT.trajectory_position_x, OUTPUT.joint_rotation) == (
        slice(2, 3), slice(4, 8), slice(8, 14), slice(218, 311),
    )  # fmt: skip
    assert OFFSETS[NOW] == 0


def test_every_column_has_a_name_of_its_own() -> None:
    for layout in (INPUT, OUTPUT):
        assert len(set(layout.names)) == len(layout.units) == layout.width
    assert OUTPUT.names[OUTPUT.joint_velocity][3] == "joint_velocity.LHipJoint.x"


def test_parents_come_before_their_children() -> None:
    assert PARENTS[0] == -1
    assert all(parent < joint for joint, parent in enumerate(PARENTS))
    assert [JOINTS[PARENTS[JOINTS.index(name)]] for name in ("LThumb", "Head")] == ["LeftHand", "Neck1"]


def test_a_block_that_does_not_exist_is_refused_by_name() -> None:
    with pytest.raises(AttributeError, match=r"no block of columns 'joint_mass' \(blocks: trajectory_position_x"):
        INPUT.joint_mass  # noqa: B018 # the access is what is tested


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"x": np.zeros((3, 341), np.float32)}, r"x should have shape \(3, 342\), but has \(3, 341\)"),
        ({"frame": np.zeros(2, np.int64)}, r"frame should have shape \(3,\)"),
        ({"y": np.full((3, 311), np.nan, np.float32)}, "y holds a value that is not finite, first in row 0"),
        ({"phase": np.full(3, 1.5, np.float32)}, r"phases should lie in \[0, 1\], but lie in \[1.5, 1.5\]"),
    ],
)
def test_broken_motion_is_refused(change: dict[str, np.ndarray], problem: str) -> None:
    whole = {
        "x": np.zeros((3, 342), np.float32), "y": np.zeros((3, 311), np.float32), "phase": np.zeros(3, np.float32),
        "clip": np.array(["a", "a", "b"]), "frame": np.arange(3), "cycle": np.zeros(3, np.int64),
    }  # fmt: skip
    assert len(Motion(**whole).select(np.array([True, False, True]))) == 2
    with pytest.raises(MotionError, match=problem):
        Motion(**{**whole, **change})


def test_a_motion_may_be_empty() -> None:
    shapes = {"x": (0, 342), "y": (0, 311), "phase": (0,), "clip": (0,), "frame": (0,), "cycle": (0,)}
    assert len(Motion(**{name: np.empty(shape) for name, shape in shapes.items()})) == 0
