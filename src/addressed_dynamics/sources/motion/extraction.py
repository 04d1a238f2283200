"""Inputs and outputs of networks, from the poses of a clip.

The feature extraction of Holden, Komura and Saito, *Phase-Functioned Neural Networks for Character Control* (SIGGRAPH
2017), section 4 and the code published with it, column for column; `layout` says what the columns are.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, Int64

from addressed_dynamics.episodes.layout import FUTURE_OFFSETS, GAITS, INPUT, INPUT_HEIGHTS, JOINTS, OFFSETS, OUTPUT
from addressed_dynamics.sources.motion.footsteps import Rows
from addressed_dynamics.sources.motion.kinematics import UP, Poses, in_root
from addressed_dynamics.sources.motion.quaternions import between, logarithm, multiply
from addressed_dynamics.sources.motion.terrain import Ground, standing

GAIT_LABELS = ("stand", "walk", "jog", "run", "crouch", "jump", "crawl", "bump")
"""Columns of a `.gait` file."""
FOLDED = {"run": "jog", "crawl": "crouch"}
"""Labels that count as another gait."""
HEAD = JOINTS.index("Head")
CROUCHING_BELOW = (80.0, 130.0)
"""Heights of the head, in cm, at which a character on flat ground crouches fully and not at all."""
AHEAD = np.array([0.0, 0.0, 1.0])
HORIZONTAL = 1.0 - UP
"""Times a vector: what it is on the ground."""


def fold_gaits(labels: Float64[np.ndarray, "frame 8"]) -> Float64[np.ndarray, "frame 6"]:
    """Return the gaits of `layout.GAITS`, of those in a `.gait` file."""
    gaits = np.zeros((len(labels), len(GAITS)))
    for column, label in enumerate(GAIT_LABELS):
        gaits[:, GAITS.index(FOLDED.get(label, label))] += labels[:, column]
    return gaits


def crouch_by_height(gaits: Float64[np.ndarray, "frame 6"], poses: Poses) -> Float64[np.ndarray, "frame 6"]:
    """Return `gaits` with crouching told by the height of the head, not by labels, as for clips on flat ground."""
    low, high = CROUCHING_BELOW
    told = gaits.copy()
    told[:, GAITS.index("crouch")] = 1 - np.clip((poses.positions[:, HEAD, 1] - low) / (high - low), 0, 1)
    return told


def row_phases(phase: Float64[np.ndarray, " frame"], rows: Rows) -> Float32[np.ndarray, " row"]:
    """Return the phase of each row: 0 at the first frame of a cycle and 1 at its last, whatever the clip says there."""
    return np.select([rows.first, rows.last], [0.0, 1.0], phase[rows.frame]).astype(np.float32)


def extract_inputs(
    poses: Poses, gaits: Float64[np.ndarray, "frame 6"], ground: Ground, frames: Int64[np.ndarray, " row"]
) -> Float32[np.ndarray, "row 342"]:
    """Return the inputs of `frames`, which have at least `cycles.REACH` frames before and after them."""
    inputs = np.empty((len(frames), INPUT.width), np.float32)
    trajectory = _trajectory(poses, frames, OFFSETS)
    for name, values in trajectory.items():
        inputs[:, INPUT[name]] = values
    around = gaits[frames[:, None] + np.array(OFFSETS)]
    for column, gait in enumerate(GAITS):
        inputs[:, INPUT[f"gait_{gait}"]] = around[..., column]
    inputs[:, INPUT.joint_position] = _positions(poses, frames - 1, ground)
    inputs[:, INPUT.joint_velocity] = _velocities(poses, frames - 1)
    inputs[:, INPUT_HEIGHTS] = ground.heights
    return inputs


def extract_outputs(
    poses: Poses, phase: Float64[np.ndarray, " frame"], ground: Ground, frames: Int64[np.ndarray, " row"]
) -> Float32[np.ndarray, "row 311"]:
    """Return the outputs of `frames`, which have at least `cycles.REACH` frames before and after them."""
    outputs = np.empty((len(frames), OUTPUT.width), np.float32)
    velocities = _velocities(poses, frames)
    outputs[:, OUTPUT.root_velocity] = velocities[:, [0, 2]]  # the root moves as the hips do, which come first
    turned = in_root(poses.facing[frames + 1], poses.facing[frames])
    outputs[:, OUTPUT.root_turn] = -np.arctan2(turned[:, 0], turned[:, 2])[:, None]
    change = phase[frames + 1] - phase[frames]
    outputs[:, OUTPUT.phase_change] = np.where(change < 0, change + 1, change)[:, None]
    outputs[:, OUTPUT.contact] = standing(poses.positions)[frames]
    for name, values in _trajectory(poses, frames + 1, FUTURE_OFFSETS).items():
        outputs[:, OUTPUT[name]] = values
    outputs[:, OUTPUT.joint_position] = _positions(poses, frames, ground)
    outputs[:, OUTPUT.joint_velocity] = velocities
    to_root = between(poses.facing[frames], AHEAD)[:, None]
    rotations = logarithm(multiply(to_root, poses.rotations[frames]))
    outputs[:, OUTPUT.joint_rotation] = rotations.reshape(len(frames), 3 * len(JOINTS))
    return outputs


def _trajectory(
    poses: Poses, frames: Int64[np.ndarray, " row"], offsets: tuple[int, ...]
) -> dict[str, Float64[np.ndarray, "row sample"]]:
    """Return where the root is and faces at `offsets` from `frames`, seen from the root at `frames`, by block."""
    sampled, seen_from = frames[:, None] + np.array(offsets), poses.facing[frames, None]
    position = in_root(poses.positions[sampled, 0] - poses.positions[frames, None, 0], seen_from)
    direction = in_root(poses.facing[sampled], seen_from)
    return {
        "trajectory_position_x": position[..., 0],
        "trajectory_position_z": position[..., 2],
        "trajectory_direction_x": direction[..., 0],
        "trajectory_direction_z": direction[..., 2],
    }


def _positions(
    poses: Poses, frames: Int64[np.ndarray, " row"], ground: Ground
) -> Float64[np.ndarray, "row coordinate"]:
    """Return the joints at `frames`, seen from the root on the ground below the hips."""
    root = poses.positions[frames, 0] * HORIZONTAL + ground.level[:, None] * UP
    seen = in_root(poses.positions[frames] - root[:, None], poses.facing[frames, None])
    return seen.reshape(len(frames), 3 * len(JOINTS))


def _velocities(poses: Poses, frames: Int64[np.ndarray, " row"]) -> Float64[np.ndarray, "row coordinate"]:
    """Return how the joints move in the world from `frames` to the next ones, seen from the root at `frames`."""
    moves = poses.positions[frames + 1] - poses.positions[frames]
    return in_root(moves, poses.facing[frames, None]).reshape(len(frames), 3 * len(JOINTS))
