from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.logs.bvh import read_bvh, write_bvh
from addressed_dynamics.logs.hierarchy import ORDERS, Skeleton

TWO_JOINTS = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Spine
  {
    OFFSET 0 2.5 0
    CHANNELS 3 Yrotation Xrotation Zrotation
    End Site
    {
      OFFSET 0 1 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.01
1 2 3 10 20 30 40 50 60
4 5 6 70 80 90 11 12 13
"""


@st.composite
def skeletons(draw: st.DrawFn) -> Skeleton:
    """Draw a skeleton whose joints are listed depth first, as files list them."""
    parents, path = [-1], [0]
    for joint in range(1, draw(st.integers(1, 8))):
        depth = draw(st.integers(1, len(path)))
        parents.append(path[depth - 1])
        path = [*path[:depth], joint]
    count = len(parents)
    offsets = np.array(draw(st.lists(st.integers(-(10**7), 10**7), min_size=3 * count, max_size=3 * count)))
    orders = draw(st.lists(st.sampled_from(ORDERS), min_size=count, max_size=count))
    names = tuple(f"joint_{joint}" for joint in range(count))
    return Skeleton(names, tuple(parents), offsets.reshape(count, 3) / 1e5, tuple(orders))


@settings(max_examples=30)
@given(skeleton=skeletons(), frames=st.integers(1, 4), seed=st.integers(0, 2**32 - 1))
def test_what_was_written_is_read_to_six_decimals(
    tmp_path_factory: pytest.TempPathFactory, skeleton: Skeleton, frames: int, seed: int
) -> None:
    generator = np.random.default_rng(seed)
    root = generator.uniform(-1e3, 1e3, (frames, 3))
    rotations = generator.uniform(-360, 360, (frames, len(skeleton.names), 3))
    rotations *= [[axis in order for axis in "xyz"] for order in skeleton.orders]
    path = tmp_path_factory.mktemp("bvh") / "clip.bvh"
    write_bvh(path, skeleton, root, rotations, frame_time=1 / 120)
    bvh = read_bvh(path)
    assert (bvh.skeleton.names, bvh.skeleton.parents, bvh.skeleton.orders) == (
        skeleton.names, skeleton.parents, skeleton.orders,
    )  # fmt: skip
    np.testing.assert_allclose(bvh.skeleton.offsets, skeleton.offsets, atol=5.1e-7)
    np.testing.assert_allclose(bvh.positions[:, 0], root, atol=5.1e-7)
    np.testing.assert_allclose(bvh.positions[:, 1:], np.tile(skeleton.offsets, (frames, 1, 1))[:, 1:], atol=5.1e-7)
    np.testing.assert_allclose(bvh.rotations, rotations, atol=5.1e-7)
    assert bvh.frame_time == 0.008333


def test_channels_are_told_apart_by_their_names(tmp_path: Path) -> None:
    bvh = read_bvh(_file(tmp_path, TWO_JOINTS))
    assert bvh.positions.tolist() == [[[1, 2, 3], [0, 2.5, 0]], [[4, 5, 6], [0, 2.5, 0]]]
    assert bvh.rotations.tolist() == [[[30, 20, 10], [50, 40, 60]], [[90, 80, 70], [12, 11, 13]]]
    assert bvh.skeleton.orders == ("zyx", "yxz")


def test_a_joint_without_channels_stays_where_its_offset_is_and_does_not_turn(tmp_path: Path) -> None:
    text = TWO_JOINTS.replace("CHANNELS 3 Yrotation Xrotation Zrotation", "CHANNELS 0")
    bvh = read_bvh(_file(tmp_path, text.replace(" 40 50 60", "").replace(" 11 12 13", "")))
    assert bvh.skeleton.orders == ("zyx", "")
    assert bvh.positions.tolist() == [[[1, 2, 3], [0, 2.5, 0]], [[4, 5, 6], [0, 2.5, 0]]]
    assert bvh.rotations.tolist() == [[[30, 20, 10], [0, 0, 0]], [[90, 80, 70], [0, 0, 0]]]


def test_fewer_channels_leave_the_other_axes_at_rest(tmp_path: Path) -> None:
    text = TWO_JOINTS.replace("CHANNELS 3 Yrotation Xrotation Zrotation", "CHANNELS 3 Zrotation Xposition Xrotation")
    bvh = read_bvh(_file(tmp_path, text))
    assert bvh.skeleton.orders == ("zyx", "zx")
    assert bvh.positions[:, 1].tolist() == [[50, 2.5, 0], [12, 2.5, 0]]
    assert bvh.rotations[:, 1].tolist() == [[60, 0, 40], [13, 0, 11]]


def test_a_skeleton_of_which_nothing_moves_is_refused(tmp_path: Path) -> None:
    head = "HIERARCHY\nROOT Hips\n{\nOFFSET 0 0 0\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\n"
    with pytest.raises(MotionError, match=r"line 11: expected at least one joint with channels"):
        read_bvh(_file(tmp_path, head + "MOTION\nFrames: 1\nFrame Time: 0.1\n\n"))


def test_joints_listed_breadth_first_keep_their_rotations_when_written(tmp_path: Path) -> None:
    skeleton = Skeleton(("root", "left", "right", "hand"), (-1, 0, 0, 1), np.zeros((4, 3)), ("zyx",) * 4)
    write_bvh(tmp_path / "clip.bvh", skeleton, np.zeros((1, 3)), np.arange(12.0).reshape(1, 4, 3), 0.1)
    bvh = read_bvh(tmp_path / "clip.bvh")
    assert bvh.skeleton.names == ("root", "left", "hand", "right")
    assert bvh.rotations[0, :, 0].tolist() == [0, 3, 9, 6]


def test_line_ends_of_windows_and_a_byte_order_mark_change_nothing(tmp_path: Path) -> None:
    plain = read_bvh(_file(tmp_path, TWO_JOINTS))
    foreign = read_bvh(_file(tmp_path, "\ufeff" + TWO_JOINTS.replace("\n", "\r\n")))
    np.testing.assert_array_equal(plain.rotations, foreign.rotations)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("HIERARCHY", "a photograph", r"clip\.bvh, line 1: expected HIERARCHY, but found 'a'"),
        ("ROOT Hips", "Hips", r"line 2: expected ROOT, but found 'Hips'"),
        ("JOINT Spine", "JOINT Hips", r"line 6: expected a joint with a name of its own, but found a second 'Hips'"),
        ("OFFSET 0 2.5 0", "OFFSET 0 up 0", r"line 8: expected a finite number, but found 'up'"),
        (
            "Yrotation Xrotation Z",
            "Yrotation Xrotation Y",
            r"line 9: .*'Spine' to have rotations .* none twice, but found",
        ),
        ("3 Yrotation Xrotation Zr", "3 Yrotation Xrotation Zm", r"line 9: .*Yrotation Xrotation Zmotation"),
        ("6 Xposition Yposition Z", "6 Xposition Yposition X", r"line 5: .*'Hips' to have rotations .* none twice"),
        ("CHANNELS 3", "CHANNELS three", r"line 9: expected a whole number from 0, but found 'three'"),
        ("CHANNELS 3", "CHANNELS -3", r"line 9: expected a whole number from 0, but found '-3'"),
        ("CHANNELS 3", "CHANNELS 0", r"line 9: expected JOINT or End or }, but found 'Yrotation'"),
        ("Frames: 2", "Frames: 0", r"line 17: expected a whole number from 1, but found '0'"),
        ("Time: 0.01", "Time: -0.01", r"line 18: expected a frame time above 0, but found -0.01 s"),
        ("Frames: 2", "Frames: 3", r"expected 3 frames, as its header says, but found 2 \(is it cut short\?\)"),
        ("Frames: 2", "Frames: 1", r"expected 1 frames, as its header says, but found 2"),
        (" 11 12 13\n", " 11 1", r"line 20: expected 9 numbers, but found 8"),
        ("1 2 3 10", "1 2 3 nan", r"line 19: expected a finite number, but found 'nan'"),
        ("70", "seventy", r"line 20: expected a finite number, but found 'seventy'"),
        (TWO_JOINTS[TWO_JOINTS.index("1 2 3") :], "", r"expected 2 frames, as its header says, but found 0"),
        (TWO_JOINTS[TWO_JOINTS.index("MOTION") :], "", r"line 15: expected MOTION, but found the end of the file"),
        (TWO_JOINTS, "", r"line 1: expected HIERARCHY, but found the end of the file"),
    ],
)
def test_a_damaged_file_is_refused_with_its_line(tmp_path: Path, before: str, after: str, message: str) -> None:
    assert TWO_JOINTS.count(before) == 1
    with pytest.raises(MotionError, match=message):
        read_bvh(_file(tmp_path, TWO_JOINTS.replace(before, after)))


def test_a_missing_file_and_a_binary_one_are_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(MotionError, match=r"absent\.bvh: cannot be read"):
        read_bvh(tmp_path / "absent.bvh")
    (tmp_path / "image.bvh").write_bytes(bytes(range(128, 256)))
    with pytest.raises(MotionError, match=r"image\.bvh, line 1: expected HIERARCHY"):
        read_bvh(tmp_path / "image.bvh")


def test_motion_that_does_not_fit_its_skeleton_is_not_written(tmp_path: Path) -> None:
    skeleton = read_bvh(_file(tmp_path, TWO_JOINTS)).skeleton
    path = tmp_path / "new.bvh"
    with pytest.raises(MotionError, match=r"2 joints need .* shapes \(5, 3\) and \(4, 2, 3\)"):
        write_bvh(path, skeleton, np.zeros((5, 3)), np.zeros((4, 2, 3)), 0.01)
    with pytest.raises(MotionError, match="not finite"):
        write_bvh(path, skeleton, np.zeros((4, 3)), np.full((4, 2, 3), np.nan), 0.01)
    stiff = replace(skeleton, orders=("zyx", "y"))
    with pytest.raises(MotionError, match=r"joint Spine is turned about an axis for which .* its order is 'y'"):
        write_bvh(path, stiff, np.zeros((4, 3)), np.ones((4, 2, 3)), 0.01)
    assert not path.exists()


def _file(folder: Path, text: str) -> Path:
    path = folder / "clip.bvh"
    path.write_text(text, encoding="utf-8", newline="")
    return path
