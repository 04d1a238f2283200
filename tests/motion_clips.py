"""Clips that tests write: the 31 joints of the PFNN skeleton in a smooth random motion, with their side files."""

from pathlib import Path

import numpy as np

from addressed_dynamics.episodes.layout import JOINTS, PARENTS
from addressed_dynamics.logs.bvh import write_bvh
from addressed_dynamics.logs.hierarchy import Skeleton

LEG = ((0, 0, 0), (1.4, -1.8, 0.8), (2.4, -6.8, 0), (2.5, -7, 0), (0.2, -0.5, 2.4))
SPINE = ((0, 0, 0), (0, 2, -0.2), (0.1, 2, 0), (0, 0.1, 0), (0, 1.7, 0.2), (0.1, 1.8, -0.1))
ARM = ((0, 0, 0), (3.1, 1.2, -0.1), (5, 0, 0), (3.6, 0, 0), (0, 0, 0), (0.7, 0, 0), (0.5, 0, 0.5))
OFFSETS = np.array([(0, 0, 0), *LEG, *LEG, *SPINE, *ARM, *ARM], dtype=np.float64)
OFFSETS[[name.startswith("R") for name in JOINTS], 0] *= -1
SKELETON = Skeleton(JOINTS, PARENTS, OFFSETS, ("zyx",) * len(JOINTS))
FOOTSTEPS = "100 150\n190 230\n290 340\n380 420\n"
"""Two cycles that a clip of 600 frames can use, after one that begins too early."""


def write_clip(
    folder: Path, name: str = "clip", *, frames: int = 600, seed: int = 0, footsteps: str = FOOTSTEPS
) -> Path:
    """Write a clip at 120 Hz, and return the path of its BVH file."""
    generator = np.random.default_rng(seed)
    # It stops for a while every three seconds, so that feet stand.
    moving = (np.arange(frames) % 360 > 60).astype(np.float64)
    seconds = np.cumsum(moving)[:, None, None] / 120
    shape = (1, len(JOINTS), 3)
    rotations = generator.uniform(5, 25, shape) * np.sin(
        generator.uniform(2, 6, shape) * seconds + generator.uniform(0, 6, shape)
    )
    rotations[:, 0, 1] += 60 * seconds[:, 0, 0]
    root = np.array([0, 17.5, 0]) + seconds[:, 0] * generator.uniform(-20, 20, 3) * [1, 0, 1]
    write_bvh(folder / f"{name}.bvh", SKELETON, root, rotations, 1 / 120)
    np.savetxt(folder / f"{name}.phase", (np.arange(frames) + 0.5) / 97 % 1, fmt="%.5f")
    np.savetxt(folder / f"{name}.gait", generator.dirichlet(np.ones(8), frames), fmt="%.5f")
    (folder / f"{name}_footsteps.txt").write_text(footsteps)
    return folder / f"{name}.bvh"
