"""BVH files: a skeleton, and for every frame where its joints sit and how they are turned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.logs.hierarchy import Skeleton, Words, hierarchy_lines, read_hierarchy
from addressed_dynamics.logs.text import parse_table, read_lines


@dataclass(frozen=True)
class Bvh:
    """What a BVH file holds."""

    skeleton: Skeleton
    """The joints."""
    positions: Float64[np.ndarray, "frame joint 3"]
    """Position of each joint in the frame of its parent: its offset, on axes for which the file has no channel."""
    rotations: Float64[np.ndarray, "frame joint 3"]
    """Angles about the joint's x, y and z axes (in this order, whatever the file's), in degrees; 0 about axes for
    which the file has no channel."""
    frame_time: float
    """Seconds from one frame to the next."""


def read_bvh(path: Path) -> Bvh:
    """Read a BVH file.

    Raises:
        MotionError: the file is missing or not BVH, has unknown channels or one of them twice, is cut short, has a line
            with more or fewer values than there are channels, or a value that is not a finite number.
    """
    lines = read_lines(path)
    words = Words(path, lines)
    skeleton, channels = read_hierarchy(words)
    words.expect("Frames:")
    frames = words.count(at_least=1)
    words.expect("Frame")
    words.expect("Time:")
    frame_time = words.number()
    if frame_time <= 0:
        words.fail("a frame time above 0", f"{frame_time:g} s")
    values = parse_table(path, lines, len(channels), after=words.line)
    if len(values) != frames:
        message = f"{path}: expected {frames} frames, as its header says, but found {len(values)} (is it cut short?)"
        raise MotionError(message)
    positions = np.tile(skeleton.offsets, (frames, 1, 1))
    rotations = np.zeros_like(positions)
    for column, channel in enumerate(channels):
        (rotations if channel.turns else positions)[:, channel.joint, channel.axis] = values[:, column]
    return Bvh(skeleton, positions, rotations, frame_time)


def write_bvh(
    path: Path,
    skeleton: Skeleton,
    root_positions: Float64[np.ndarray, "frame 3"],
    rotations: Float64[np.ndarray, "frame joint 3"],
    frame_time: float,
) -> None:
    """Write a BVH file, atomically; numbers have six decimals.

    Args:
        path: where to.
        skeleton: the joints. The file lists them depth first, whatever their order here.
        root_positions: where the root is, in the unit of the skeleton's offsets.
        rotations: angles about the joints' x, y and z axes (in this order, whatever the joints'), in degrees.
        frame_time: seconds from one frame to the next.

    Raises:
        MotionError: the arrays do not fit the skeleton or each other, hold a value that is not finite, or turn a joint
            about an axis that is not in its order.
    """
    frames, joints = len(root_positions), len(skeleton.names)
    if root_positions.shape != (frames, 3) or rotations.shape != (frames, joints, 3):
        message = (
            f"{path}: {joints} joints need root positions of shape (frame, 3) and rotations of shape "
            f"(frame, {joints}, 3), but these have shapes {root_positions.shape} and {rotations.shape}"
        )
        raise MotionError(message)
    if not (np.isfinite(root_positions).all() and np.isfinite(rotations).all()):
        message = f"{path}: a root position or a rotation that should be written is not finite"
        raise MotionError(message)
    for joint, order in enumerate(skeleton.orders):
        if any(rotations[:, joint, "xyz".index(axis)].any() for axis in set("xyz").difference(order)):
            message = (
                f"{path}: joint {skeleton.names[joint]} is turned about an axis for which it has no channel, since its "
                f"order is '{order}'; give it another order"
            )
            raise MotionError(message)
    turned = [
        rotations[:, joint, ["xyz".index(axis) for axis in skeleton.orders[joint]]] for joint in _depth_first(skeleton)
    ]
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write("HIERARCHY\n")
        file.writelines(f"{line}\n" for line in hierarchy_lines(skeleton))
        file.write(f"MOTION\nFrames: {frames}\nFrame Time: {frame_time:.6f}\n")
        np.savetxt(file, np.concatenate([root_positions, *turned], axis=1), fmt="%.6f")


def _depth_first(skeleton: Skeleton, joint: int = 0) -> Iterator[int]:
    yield joint
    for child, parent in enumerate(skeleton.parents):
        if parent == joint:
            yield from _depth_first(skeleton, child)
