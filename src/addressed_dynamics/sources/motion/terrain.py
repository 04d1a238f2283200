"""The ground under a character: flat at a height that its feet tell, or given as a map of heights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.episodes.layout import JOINTS, OFFSETS
from addressed_dynamics.logs.text import parse_table, read_lines
from addressed_dynamics.sources.motion.footsteps import REACH, Cycle
from addressed_dynamics.sources.motion.kinematics import Poses

FEET = tuple(JOINTS.index(name) for name in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"))
"""Joints of the heels and toes, in the order of `layout.CONTACTS`."""
FEET_ABOVE_GROUND = np.array([5.0, 4.0, 5.0, 4.0])
"""Heights of these joints above the ground that the foot stands on, in cm."""
STANDING_SPEED_SQUARED = 0.02
"""A foot stands if it moves by less than the square root of this in a frame, in cm."""
SIDES = (25.0, 0.0, -25.0)
"""Where the ground is looked at, in cm along the x axis of the root. Order and names are the published ones: 'right' is
the first, although a character that faces z has x on its left."""


@dataclass(frozen=True)
class Ground:
    """The ground at the frames of which rows are made."""

    level: Float64[np.ndarray, " row"]
    """Mean height below the trajectory, in cm; joints are measured from it."""
    heights: Float64[np.ndarray, "row 36"]
    """Heights at `SIDES` of the trajectory, side by side, above `level`, in cm."""


@dataclass(frozen=True)
class HeightMap:
    """Heights of the ground on a grid."""

    heights: Float64[np.ndarray, "z x"]
    """In cm; at least one."""
    cell: float
    """Distance of neighbours, in cm."""
    origin: tuple[float, float]
    """World x and z of `heights[0, 0]`, in cm."""

    def at(self, x: Float64[np.ndarray, "*n"], z: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n"]:
        """Return the heights at points: linear in x and z between grid points, those of the edge beyond it."""
        rows, columns = self.heights.shape
        column = np.clip((x - self.origin[0]) / self.cell, 0, columns - 1)
        row = np.clip((z - self.origin[1]) / self.cell, 0, rows - 1)
        left, low = column.astype(np.int64), row.astype(np.int64)
        right, high = np.minimum(left + 1, columns - 1), np.minimum(low + 1, rows - 1)
        a, b = column - left, row - low
        heights: Float64[np.ndarray, "*n"] = (1 - b) * (
            (1 - a) * self.heights[low, left] + a * self.heights[low, right]
        ) + b * ((1 - a) * self.heights[high, left] + a * self.heights[high, right])
        return heights


def read_height_map(path: Path) -> HeightMap:
    """Read a height map.

    The first line of the text file holds the size of a cell and the world x and z of the first height; every other
    line holds heights along x, one line for each z. All in cm.

    Raises:
        MotionError: the file cannot be read, a line has too few or too many numbers, or a number makes no sense.
    """
    lines = read_lines(path)
    for number, content in ((1, "cell size, x and z"), (2, "heights along x")):
        if len(lines) < number or not lines[number - 1].split():
            message = f"{path}, line {number}: expected {content}, but found nothing"
            raise MotionError(message)
    cell, x, z = parse_table(path, lines[:1], 3)[0]
    if cell <= 0:
        message = f"{path}, line 1: expected a cell size above 0 cm, but found {cell:g}"
        raise MotionError(message)
    return HeightMap(parse_table(path, lines, len(lines[1].split()), after=1), float(cell), (float(x), float(z)))


def standing(positions: Float64[np.ndarray, "frame joint 3"]) -> Bool[np.ndarray, "move foot"]:
    """Return which of `FEET` stand from each frame to the next."""
    feet = positions[:, FEET]
    moves: Bool[np.ndarray, "move foot"] = ((feet[1:] - feet[:-1]) ** 2).sum(axis=-1) < STANDING_SPEED_SQUARED
    return moves


def flat_ground(poses: Poses, cycles: list[Cycle]) -> Ground:
    """Return flat ground for the frames of `cycles`: at each cycle, as high as the feet that stand tell on average.

    Feet count from the first frame that the cycle's trajectory looks at to one frame after the last.
    """
    stand = standing(poses.positions)
    below_feet = poses.positions[:, FEET, 1] - FEET_ABOVE_GROUND
    levels = []
    for cycle in cycles:
        around = slice(cycle.first - REACH, cycle.last + REACH + 1)
        moves = stand[around.start : around.stop - 1]
        told = below_feet[around][np.concatenate([moves, moves[-1:]])]
        levels += [told.mean() if len(told) else 0.0] * (cycle.last + 1 - cycle.first)
    return Ground(np.array(levels), np.zeros((len(levels), len(SIDES) * len(OFFSETS))))


def mapped_ground(poses: Poses, frames: Int64[np.ndarray, " row"], height_map: HeightMap) -> Ground:
    """Return the ground of a height map at `frames`."""
    sampled = frames[:, None] + np.array(OFFSETS)
    root, ahead = poses.positions[sampled, 0], poses.facing[sampled]
    heights = np.stack(
        [height_map.at(root[..., 0] + side * ahead[..., 2], root[..., 2] - side * ahead[..., 0]) for side in SIDES],
        axis=1,
    )
    level = heights[:, SIDES.index(0.0)].mean(axis=-1)
    return Ground(level, (heights - level[:, None, None]).reshape(len(frames), len(SIDES) * len(OFFSETS)))
