from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import JOINTS, OFFSETS
from addressed_dynamics.sources.motion.footsteps import Cycle
from addressed_dynamics.sources.motion.kinematics import Poses
from addressed_dynamics.sources.motion.terrain import (
    FEET,
    HeightMap,
    flat_ground,
    mapped_ground,
    read_height_map,
    standing,
)

LEFT_TOE = FEET[1]


def _walk_along_z(frames: int = 200) -> Poses:
    """Somebody who moves along z by 1 cm a frame, faces x, and drags all joints along."""
    positions = np.zeros((frames, len(JOINTS), 3))
    positions[..., 2] = np.arange(frames)[:, None]
    return Poses(positions, np.zeros((frames, len(JOINTS), 4)), np.tile([1.0, 0, 0], (frames, 1)))


@given(seed=st.integers(0, 2**32 - 1))
def test_a_map_of_a_plane_gives_the_plane_and_its_edge_beyond(seed: int) -> None:
    generator = np.random.default_rng(seed)
    a, b, c = generator.normal(size=3)
    x, z = -20 + 5.0 * np.arange(7), 40 + 5.0 * np.arange(4)
    height_map = HeightMap(a * x + b * z[:, None] + c, cell=5.0, origin=(-20.0, 40.0))
    at = generator.uniform((-50, 0), (50, 100), (2, 3, 2))
    inside = np.clip(at, (x[0], z[0]), (x[-1], z[-1]))
    np.testing.assert_allclose(
        height_map.at(at[..., 0], at[..., 1]), a * inside[..., 0] + b * inside[..., 1] + c, atol=1e-9
    )


def test_a_height_map_is_read_with_its_cell_size_and_origin(tmp_path: Path) -> None:
    (tmp_path / "map.txt").write_text("10 -5 20\n1 2 3\n4 5 6\n")
    height_map = read_height_map(tmp_path / "map.txt")
    assert (height_map.cell, height_map.origin, height_map.heights.tolist()) == (10, (-5, 20), [[1, 2, 3], [4, 5, 6]])
    assert height_map.at(np.array([5.0]), np.array([30.0])) == 5


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"map\.txt, line 1: expected cell size, x and z, but found nothing"),
        ("10 0 0\n", r"line 2: expected heights along x, but found nothing"),
        ("10 0\n1 2", r"line 1: expected 3 numbers, but found 2"),
        ("-1 0 0\n1 2", r"line 1: expected a cell size above 0 cm, but found -1"),
        ("10 0 0\n1 2\n3", r"line 3: expected 2 numbers, but found 1"),
        ("10 0 0\n1 2\n3 inf", r"line 3: expected a finite number, but found 'inf'"),
    ],
)
def test_a_damaged_height_map_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "map.txt").write_text(text)
    with pytest.raises(MotionError, match=message):
        read_height_map(tmp_path / "map.txt")


def test_heights_are_those_beside_the_trajectory_above_their_mean_below_it() -> None:
    poses, frames = _walk_along_z(), np.array([60, 70])
    # The ground rises by 1 cm in every 10 along z. Who faces x has the x axis of the root along -z.
    height_map = HeightMap(np.arange(0, 41.0)[:, None], cell=10.0, origin=(0.0, -100.0))
    ground = mapped_ground(poses, frames, height_map)
    below = (frames[:, None] + np.array(OFFSETS) + 100) / 10
    np.testing.assert_allclose(ground.level, below.mean(axis=1))
    expected = [below - 2.5, below, below + 2.5]
    np.testing.assert_allclose(ground.heights, np.concatenate(expected, axis=1) - ground.level[:, None], atol=1e-12)


def test_a_foot_stands_while_it_hardly_moves() -> None:
    positions = np.zeros((4, len(JOINTS), 3))
    positions[:, LEFT_TOE, 0] = [0, 0.14, 0.282, 0.282]
    assert standing(positions)[:, 1].tolist() == [True, False, True]
    assert standing(positions)[:, [0, 2, 3]].all()


def test_flat_ground_is_as_high_as_standing_feet_tell() -> None:
    poses = _walk_along_z()
    # The left toe, 4 cm above what it stands on, rests at height 6 during one cycle and at height 7 in the other.
    poses.positions[60:70, LEFT_TOE] = [0, 6, 0]
    poses.positions[180:185, LEFT_TOE] = [0, 7, 0]
    ground = flat_ground(poses, [Cycle(0, 60, 70), Cycle(1, 130, 132)])
    np.testing.assert_allclose(ground.level, [2] * 11 + [3] * 3)
    assert ground.heights.shape == (14, 36)
    assert not ground.heights.any()


def test_ground_that_no_foot_touches_is_at_zero() -> None:
    np.testing.assert_array_equal(flat_ground(_walk_along_z(), [Cycle(0, 60, 61)]).level, [0, 0])
