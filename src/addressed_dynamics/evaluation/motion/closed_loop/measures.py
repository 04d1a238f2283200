"""What can be measured of moving joints, recorded or generated: limb speed, sliding feet, bone lengths, hip height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Complex128, Float, Float64, Int64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import FRAME_RATE, GAITS, JOINTS, OUTPUT, PARENTS
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.simulators.motion_ground import current_gait, ground, ground_of

FEET = tuple(JOINTS.index(name) for name in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase"))
"""Joints whose contacts are predicted, in the order of `layout.CONTACTS`."""
TOUCHING = 0.5
"""A foot touches the ground where its contact is above this."""
HIPS = JOINTS.index("Hips")
CHILDREN = np.arange(1, len(JOINTS))
SHORTEST_BONE = 0.1
"""Bones shorter than this, in cm, join joints that lie in the same place: they have no length that could drift."""
HEIGHT_QUANTILES = (0.001, 0.999)
HEIGHT_SLACK = 0.1
"""Hips are at a plausible height if it is between these quantiles of recorded motion, give or take this share."""


@dataclass(frozen=True)
class GaitReference:
    """How recorded motion moves in a gait; speeds in cm/s."""

    gait: str
    """One of `layout.GAITS`, or `all`."""
    frames: int
    root_speed: float
    limb_speed: float
    """Mean speed of the joints relative to the root."""
    skate_speed: float | None
    """Mean speed of feet along the ground while they touch it; None if none ever does."""
    slowest_foot_speed: float
    """Mean speed along the ground of the slowest of heels and toes: near 0 whenever something stands still."""
    contact_share: float
    """Share of heels and toes that touch the ground."""


@dataclass(frozen=True)
class MotionReference:
    """What generated motion is held against: the same measures on recorded motion."""

    gaits: tuple[GaitReference, ...]
    """All frames, and then the gaits that occur."""
    bone_length: tuple[float, ...]
    """Mean length of the bone to each joint from its parent, in cm; 0 for the hips, which have no parent."""
    lowest_hips: float
    """In cm above the ground; lower is not plausible."""
    highest_hips: float


def data_reference(motion: Motion) -> MotionReference:
    """Measure recorded motion, per gait, from its outputs: velocities are those of joints in the world.

    Raises:
        EvaluationError: the motion has no frames.
    """
    if not len(motion):
        message = "there is no recorded motion to compare with: the motion has no frames"
        raise EvaluationError(message)
    y = motion.y.astype(np.float64)
    position = y[:, OUTPUT.joint_position].reshape(-1, len(JOINTS), 3)
    velocity = y[:, OUTPUT.joint_velocity].reshape(-1, len(JOINTS), 3)
    root_velocity = y[:, OUTPUT.root_velocity]
    root = ground(root_velocity[:, 0], root_velocity[:, 1])
    limb, feet = limb_speed(velocity, root), foot_speeds(velocity)
    touching = y[:, OUTPUT.contact] > TOUCHING
    gait = current_gait(motion.x)
    groups = {"all": np.ones(len(y), np.bool_)} | {name: gait == index for index, name in enumerate(GAITS)}
    low, high = np.quantile(position[:, HIPS, 1], HEIGHT_QUANTILES)
    return MotionReference(
        gaits=tuple(
            GaitReference(
                gait=name,
                frames=int(rows.sum()),
                root_speed=float(np.abs(root[rows]).mean()) * FRAME_RATE,
                limb_speed=float(limb[rows].mean()),
                skate_speed=mean_or_none(feet[rows][touching[rows]]),
                slowest_foot_speed=float(feet[rows].min(axis=1).mean()),
                contact_share=float(touching[rows].mean()),
            )
            for name, rows in groups.items()
            if rows.any()
        ),
        bone_length=tuple(float(length) for length in np.append(0.0, bone_lengths(position).mean(axis=0))),
        lowest_hips=float(low) * (1.0 - HEIGHT_SLACK),
        highest_hips=float(high) * (1.0 + HEIGHT_SLACK),
    )


def limb_speed(
    velocity: Float[np.ndarray, "frame 31 3"], root_velocity: Complex128[np.ndarray, " frame"]
) -> Float64[np.ndarray, " frame"]:
    """Return the mean speed of the joints relative to the root, in cm/s, from velocities in cm/frame."""
    along = np.abs(ground_of(velocity) - root_velocity[:, None])
    speed: Float64[np.ndarray, " frame"] = np.hypot(along, velocity[..., 1]).mean(axis=1) * FRAME_RATE
    return speed


def foot_speeds(velocity: Float[np.ndarray, "frame 31 3"]) -> Float64[np.ndarray, "frame 4"]:
    """Return how fast heels and toes move along the ground, in cm/s, from velocities in cm/frame."""
    speed: Float64[np.ndarray, "frame 4"] = np.abs(ground_of(velocity[:, FEET])) * FRAME_RATE
    return speed


def bone_lengths(position: Float[np.ndarray, "frame 31 3"]) -> Float64[np.ndarray, "frame 30"]:
    """Return the lengths of the bones to all joints but the hips, in cm."""
    bones = position[:, CHILDREN] - position[:, np.array(PARENTS)[CHILDREN]]
    lengths: Float64[np.ndarray, "frame 30"] = np.linalg.norm(bones.astype(np.float64), axis=-1)
    return lengths


def bone_drift(
    position: Float[np.ndarray, "frame 31 3"], reference: MotionReference
) -> Float64[np.ndarray, "frame bone"]:
    """Return by what share of its length each bone is too long or too short."""
    expected = np.array(reference.bone_length)[CHILDREN]
    real = expected > SHORTEST_BONE
    drift: Float64[np.ndarray, "frame bone"] = np.abs(bone_lengths(position)[:, real] / expected[real] - 1.0)
    return drift


def smoothed_velocity(root: Complex128[np.ndarray, " frame"], window: int) -> Complex128[np.ndarray, " frame"]:
    """Return the mean velocity over the `window` frames around each frame, fewer at the ends, in cm/frame."""
    frames: Int64[np.ndarray, " frame"] = np.arange(len(root))
    first = np.maximum(frames - window // 2, 0)
    last = np.minimum(frames + window // 2, len(root) - 1)
    velocity: Complex128[np.ndarray, " frame"] = (root[last] - root[first]) / np.maximum(last - first, 1)
    return velocity


def mean_or_none(values: Float[np.ndarray, " any"]) -> float | None:
    """Return the mean; None of nothing."""
    return float(values.mean()) if len(values) else None
