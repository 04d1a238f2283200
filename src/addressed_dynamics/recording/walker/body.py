"""The walker's body: how long its bones are."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.episodes.layout import JOINTS

THIGH, SHIN = 41.0, 40.5
"""Length of thigh and shin, in cm."""
_LEFT_OFFSETS = {
    "LeftUpLeg": (8.2, -9.4, 1.0),
    "LeftLeg": (0.0, -THIGH, 0.0),
    "LeftFoot": (0.0, -SHIN, 0.0),
    "LeftToeBase": (0.0, -5.4, 12.6),
    "LeftArm": (17.5, 8.5, -1.5),
    "LeftForeArm": (28.5, 0.0, 0.0),
    "LeftHand": (23.5, 0.0, 0.0),
    "LeftHandIndex1": (5.0, 0.0, 0.0),
}
_MIDDLE_OFFSETS = {
    "Spine": (0.0, 11.6, -0.8),
    "Spine1": (0.0, 12.0, 0.0),
    "Neck1": (0.0, 11.0, 0.6),
    "Head": (0.0, 10.4, 0.8),
}


def other_side(joint: str) -> str:
    """Return the name of the joint on the other side of the body."""
    for ours, theirs in (("Left", "Right"), ("Right", "Left"), ("LHip", "RHip"), ("RHip", "LHip")):
        if joint.startswith(ours):
            return theirs + joint.removeprefix(ours)
    return {"LThumb": "RThumb", "RThumb": "LThumb"}.get(joint, joint)


def _offsets() -> Float64[np.ndarray, "31 3"]:
    offsets = np.zeros((len(JOINTS), 3))
    for joint, offset in (_LEFT_OFFSETS | _MIDDLE_OFFSETS).items():
        offsets[JOINTS.index(joint)] = offset
        if joint in _LEFT_OFFSETS:
            offsets[JOINTS.index(other_side(joint))] = offset * np.array([-1.0, 1.0, 1.0])
    return offsets


OFFSETS = _offsets()
"""Where each joint of `layout.SKELETON` sits in the frame of its parent, in cm: a person who stands with the arms
stretched out sideways (some joints sit where their parents do, as in the published clips)."""
STANDING = THIGH + SHIN + 9.4 + 8.1 - 1.4
"""Height of the hips of a person who stands, in cm: the legs are not quite straight."""
MIRRORED = np.array([JOINTS.index(other_side(joint)) for joint in JOINTS])
"""For each joint, the one on the other side."""
