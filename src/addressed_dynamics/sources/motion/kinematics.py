"""Where joints are in the world, where a character faces, and what either is in the frame of its root."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.episodes.layout import JOINTS
from addressed_dynamics.sources.motion.quaternions import from_euler, multiply, rotate

SHOULDERS = (JOINTS.index("LeftArm"), JOINTS.index("RightArm"))
HIPS = (JOINTS.index("LeftUpLeg"), JOINTS.index("RightUpLeg"))
UP = np.array([0.0, 1.0, 0.0])
SMOOTHING = 20.0
"""Standard deviation of the Gaussian that smooths the facing, in frames at 60 Hz."""
TRUNCATION = 4.0
"""Standard deviations at which that Gaussian is cut off."""


@dataclass(frozen=True)
class Poses:
    """A character at every frame of a clip, at 60 Hz, in the world: y up, the ground about y = 0."""

    positions: Float64[np.ndarray, "frame joint 3"]
    """Position of each joint, in cm."""
    rotations: Float64[np.ndarray, "frame joint 4"]
    """Rotation of each joint."""
    facing: Float64[np.ndarray, "frame 3"]
    """Where the character faces: level, of length 1."""

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.facing)


def joint_rotations(
    angles: Float64[np.ndarray, "frame joint 3"], orders: tuple[str, ...]
) -> Float64[np.ndarray, "frame joint 4"]:
    """Return the rotation of each joint in the frame of its parent.

    Args:
        angles: about its x, y and z axes, in degrees.
        orders: the order of its rotations.
    """
    rotations, radians = np.empty((*angles.shape[:2], 4)), np.radians(angles)
    for order in sorted(set(orders)):
        joints = [joint for joint, each in enumerate(orders) if each == order]
        rotations[:, joints] = from_euler(radians[:, joints], order)
    return rotations


def forward_kinematics(
    positions: Float64[np.ndarray, "frame joint 3"],
    rotations: Float64[np.ndarray, "frame joint 4"],
    parents: tuple[int, ...],
) -> tuple[Float64[np.ndarray, "frame joint 3"], Float64[np.ndarray, "frame joint 4"]]:
    """Return positions and rotations of the joints in the world.

    Args:
        positions: of each joint in the frame of its parent; of the root in the world.
        rotations: likewise.
        parents: index of each joint's parent, which comes before it; -1 for the root.
    """
    placed, turned = positions.copy(), rotations.copy()
    for joint, parent in enumerate(parents):
        if parent >= 0:
            turned[:, joint] = multiply(turned[:, parent], rotations[:, joint])
            placed[:, joint] = placed[:, parent] + rotate(turned[:, parent], positions[:, joint])
    return placed, turned


def facing(positions: Float64[np.ndarray, "frame joint 3"]) -> Float64[np.ndarray, "frame 3"]:
    """Return where the character faces: level vectors of length 1.

    The mean of what points from right to left across the shoulders and across the hips, turned to the front and
    smoothed over time.

    Args:
        positions: of the joints of `layout.SKELETON` in the world, at 60 Hz.
    """
    across = np.add(*(positions[:, left] - positions[:, right] for left, right in (SHOULDERS, HIPS)))
    forward = smooth(np.cross(across / np.linalg.norm(across, axis=-1, keepdims=True), UP), SMOOTHING)
    directions: Float64[np.ndarray, "frame 3"] = forward / np.linalg.norm(forward, axis=-1, keepdims=True)
    return directions


def smooth(values: Float64[np.ndarray, "frame column"], deviation: float) -> Float64[np.ndarray, "frame column"]:
    """Return `values`, smoothed over frames by a Gaussian, as if the first and the last row went on for ever.

    Args:
        values: one row a frame.
        deviation: standard deviation of the Gaussian, in frames; it is cut off at `TRUNCATION` of them.
    """
    reach = int(TRUNCATION * deviation + 0.5)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / deviation) ** 2)
    weights /= weights.sum()
    padded = np.pad(values, ((reach, reach), (0, 0)), mode="edge")
    return np.stack([np.convolve(column, weights, mode="valid") for column in padded.T], axis=-1)


def in_root(vectors: Float64[np.ndarray, "*n 3"], facing: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
    """Return `vectors` as a character sees them whose z axis points to `facing`; the y axis stays up."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    sine, _, cosine = np.moveaxis(facing, -1, 0)
    return np.stack(np.broadcast_arrays(x * cosine - z * sine, y, x * sine + z * cosine), axis=-1)
