import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from motion_clips import OFFSETS, SKELETON, write_clip
from naive_motion import read_naively
from scipy.spatial.transform import Rotation

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import GAITS, INPUT, INPUT_HEIGHTS, JOINTS, NOW, OUTPUT, PARENTS
from addressed_dynamics.logs.bvh import read_bvh, write_bvh
from addressed_dynamics.logs.hierarchy import ORDERS, Skeleton
from addressed_dynamics.sources.motion.clips import read_clip, read_clips


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_clip(tmp_path_factory.mktemp("clips"))


@pytest.fixture
def copy(clip: Path, tmp_path: Path) -> Path:
    """Copy the clip to where a test may damage it."""
    shutil.copytree(clip.parent, tmp_path, dirs_exist_ok=True)
    return tmp_path / clip.name


def test_extraction_agrees_with_a_naive_one_frame_by_frame(clip: Path) -> None:
    motion = read_clip(clip)
    x, y, phase, frames = read_naively(clip)
    assert 0 < y[:, OUTPUT.contact].mean() < 1
    np.testing.assert_allclose(motion.x, x, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(motion.y, y, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(motion.phase, phase, atol=1e-7)
    assert motion.frame.tolist() == frames


def test_rows_are_the_frames_of_the_cycles_with_both_ends(clip: Path) -> None:
    motion = read_clip(clip)
    assert motion.frame.tolist() == [*range(95, 146), *range(145, 191)]
    assert motion.cycle.tolist() == [1] * 51 + [2] * 46
    assert set(motion.clip) == {"clip"}
    assert np.flatnonzero(motion.phase == 0).tolist() == [0, 51]
    assert np.flatnonzero(motion.phase == 1).tolist() == [50, 96]


def test_within_a_cycle_the_next_input_repeats_what_the_output_says(clip: Path) -> None:
    motion = read_clip(clip)
    cycle = motion.select(motion.cycle == 1)
    for name in ("joint_position", "joint_velocity"):
        np.testing.assert_array_equal(cycle.y[:-1, OUTPUT[name]], cycle.x[1:, INPUT[name]])
    for name in ("trajectory_position_x", "trajectory_direction_z"):
        np.testing.assert_array_equal(cycle.y[:-1, OUTPUT[name]], cycle.x[1:, INPUT[name]][:, NOW:])


def test_a_joint_order_and_a_rate_of_its_own_change_nothing(clip: Path, tmp_path: Path) -> None:
    bvh = read_bvh(clip)
    # Every sibling swaps its place; every second frame makes a clip at 60 Hz.
    order = sorted(range(len(JOINTS)), key=lambda joint: (_depth(joint), -joint))
    skeleton = Skeleton(
        tuple(JOINTS[joint] for joint in order),
        tuple(order.index(PARENTS[joint]) if PARENTS[joint] >= 0 else -1 for joint in order),
        OFFSETS[order],
        ("zyx",) * len(order),
    )
    path = tmp_path / "clip.bvh"
    write_bvh(path, skeleton, bvh.positions[::2, 0], bvh.rotations[::2, order], 1 / 60)
    assert read_bvh(path).skeleton.names != JOINTS
    for end in (".phase", ".gait"):
        lines = clip.with_suffix(end).read_text().splitlines()
        path.with_suffix(end).write_text("\n".join(lines[::2]))
    (tmp_path / "clip_footsteps.txt").write_text("50 75\n95 115\n145 170\n190 210\n")
    one, other = read_clip(path), read_clip(clip)
    np.testing.assert_array_equal(one.x, other.x)
    np.testing.assert_array_equal(one.y, other.y)


def test_the_same_poses_with_other_channels_in_every_clip_are_the_same_motion(clip: Path, tmp_path: Path) -> None:
    bvh = read_bvh(clip)
    generator = np.random.default_rng(0)
    # The spine and the hands stay still; every other joint turns as before.
    still = np.array(["Spine" in name or "Hand" in name for name in JOINTS])
    rotations = bvh.rotations * ~still[:, None]
    turns = Rotation.from_euler("ZYX", rotations.reshape(-1, 3)[:, ::-1], degrees=True)
    full = [order for order in ORDERS if len(order) == 3]
    for number, draw in enumerate([lambda: "zyx", lambda: "yxz", lambda: str(generator.choice(full))]):
        orders = tuple("" if quiet and number else draw() for quiet in still)
        angles = np.zeros_like(rotations)
        for joint, order in enumerate(orders):
            if order:
                found = turns.as_euler(order.upper(), degrees=True).reshape(rotations.shape)[:, joint]
                angles[:, joint, ["xyz".index(axis) for axis in order]] = found
        for end in (".phase", ".gait", "_footsteps.txt"):
            shutil.copy(clip.with_name(clip.stem + end), tmp_path / f"clip-{number}{end}")
        path = tmp_path / f"clip-{number}.bvh"
        write_bvh(path, Skeleton(JOINTS, PARENTS, OFFSETS, orders), bvh.positions[:, 0], angles, bvh.frame_time)
    assert "CHANNELS 0" not in (tmp_path / "clip-0.bvh").read_text()
    assert "CHANNELS 0\n" in path.read_text()
    motions = list(read_clips(tmp_path))
    assert len(motions) == 3
    for motion in motions[1:]:
        np.testing.assert_allclose(motion.x, motions[0].x, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(motion.y, motions[0].y, rtol=1e-4, atol=1e-4)


def test_a_height_map_lowers_the_joints_and_leaves_crouching_to_the_labels(copy: Path) -> None:
    flat = read_clip(copy)
    copy.with_name("clip_heightmap.txt").write_text("100 -1000 -1000\n7 7\n7 7\n")
    mapped = read_clip(copy)
    labels = np.loadtxt(copy.with_suffix(".gait"))[::2][mapped.frame]
    np.testing.assert_allclose(mapped.x[:, INPUT.gait_crouch][:, NOW], labels[:, 4] + labels[:, 6], atol=1e-7)
    np.testing.assert_allclose(mapped.x[:, INPUT_HEIGHTS], 0, atol=1e-12)
    lowered = (flat.y - mapped.y)[:, OUTPUT.joint_position].reshape(len(flat), -1, 3)
    bottom = 7 - lowered[..., 1]  # what the feet told before
    np.testing.assert_allclose(lowered[..., [0, 2]], 0, atol=1e-4)
    np.testing.assert_allclose(bottom[:51], bottom[0, 0], atol=1e-4)
    differing = {name for name in (f"gait_{gait}" for gait in GAITS) if (flat.x != mapped.x)[:, INPUT[name]].any()}
    assert differing == {"gait_crouch"}


def test_clips_come_by_name_and_a_rest_pose_is_none(copy: Path) -> None:
    write_clip(copy.parent, "a_mirror", frames=400, footsteps="130 150\n160 170\n")
    write_bvh(copy.with_name("rest.bvh"), SKELETON, np.zeros((1, 3)), np.zeros((1, len(JOINTS), 3)), 1 / 24)
    assert [(motion.clip[0], len(motion)) for motion in read_clips(copy.parent)] == [("a_mirror", 16), ("clip", 97)]


def test_a_clip_without_a_cycle_that_can_be_used_has_no_rows(copy: Path) -> None:
    write_clip(copy.parent, "short", frames=100)
    assert [len(motion) for motion in read_clips(copy.parent)] == [97, 0]


@pytest.mark.parametrize("end", [".bvh", ".phase", ".gait", "_footsteps.txt"])
def test_a_clip_that_lacks_a_file_is_refused_by_its_name(copy: Path, end: str) -> None:
    (copy.parent / f"clip{end}").unlink()
    with pytest.raises(MotionError, match=rf"the clip 'clip' lacks clip{end}"):
        list(read_clips(copy.parent))


def test_a_folder_without_clips_or_without_cycles_is_refused(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(MotionError, match="expected a folder of clips"):
            list(read_clips(folder))
    write_clip(tmp_path, footsteps="100 120\n")
    with pytest.raises(MotionError, match="none of its 1 clips has a gait cycle"):
        list(read_clips(tmp_path))


def _drop_last_line(path: Path) -> None:
    path.write_text("\n".join(path.read_text().splitlines()[:-1]))


def _replace(before: str, after: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(path.read_text().replace(before, after, 1)) and None


@pytest.mark.parametrize(
    ("end", "damage", "message"),
    [
        (".phase", _drop_last_line, r"clip\.phase: expected 600 lines, one for each frame of the clip, but found 599"),
        (".gait", _drop_last_line, r"clip\.gait: expected 600 lines, one for each frame of the clip, but found 599"),
        (".bvh", _drop_last_line, r"clip\.bvh: expected 600 frames, as its header says, but found 599"),
        (".phase", _replace("0.01546\n", "1.01546\n"), r"clip\.phase: .* in \[0, 1\], but found 1\.01546 at frame 1"),
        (".phase", _replace("0.01546\n", "\n"), r"clip\.phase: expected 600 lines"),
        (".phase", _replace("0.01546\n", "late\n"), r"clip\.phase, line 2: expected a finite number, but found 'late'"),
        (".gait", _replace(" ", " 0 "), r"clip\.gait, line 1: expected 8 numbers, but found 9"),
        ("_footsteps.txt", _replace("290", "heel"), r"clip_footsteps\.txt, line 3: expected the number of a frame"),
        (
            ".bvh",
            _replace("Frame Time: 0.00833", "Frame Time: 0.01"),
            r"expected 120 frames per second .* but found 76\.9",
        ),
        (".bvh", _replace("JOINT LThumb", "JOINT Tail"), r"31 joints .*; missing: LThumb; unexpected: Tail"),
    ],
)
def test_a_damaged_clip_is_refused_with_its_file(
    copy: Path, end: str, damage: Callable[[Path], None], message: str
) -> None:
    damage(copy.parent / f"clip{end}")
    with pytest.raises(MotionError, match=message):
        read_clip(copy)


def test_another_skeleton_is_refused_with_its_joints(copy: Path) -> None:
    names = ("Hips", "Chest", "Head")
    skeleton = Skeleton(names, (-1, 0, 1), np.zeros((3, 3)), ("zyx",) * 3)
    write_bvh(copy, skeleton, np.zeros((600, 3)), np.zeros((600, 3, 3)), 1 / 120)
    with pytest.raises(MotionError, match=r"missing: LHipJoint, .*RThumb; unexpected: Chest"):
        read_clip(copy)


def test_joints_that_hang_together_otherwise_are_refused(copy: Path) -> None:
    parents = tuple(JOINTS.index("Spine") if name == "LeftShoulder" else PARENTS[i] for i, name in enumerate(JOINTS))
    skeleton = Skeleton(JOINTS, parents, OFFSETS, ("zyx",) * len(JOINTS))
    write_bvh(copy, skeleton, np.zeros((600, 3)), np.zeros((600, len(JOINTS), 3)), 1 / 120)
    with pytest.raises(MotionError, match="the joint LeftShoulder to hang on Spine1, but it hangs on Spine"):
        read_clip(copy)


def _depth(joint: int) -> int:
    return 0 if PARENTS[joint] < 0 else 1 + _depth(PARENTS[joint])
