"""The ground plane as complex numbers, z + ix, and what a motion frame says of it.

A heading of h radians is the number exp(ih): 0 looks along z, and pi/2 along x. Multiplying by it turns a vector of a
root's frame into the world, and by its conjugate back.
"""

import numpy as np
from jaxtyping import Complex, Float, Int64

from addressed_dynamics.episodes.layout import GAITS, INPUT, NOW

JOINT_X, JOINT_Y, JOINT_Z = (slice(axis, None, 3) for axis in range(3))
"""Every third column of a block of joints."""


def ground(x: Float[np.ndarray, "*any"], z: Float[np.ndarray, "*any"]) -> Complex[np.ndarray, "*any"]:
    """Return points of the ground plane as complex numbers."""
    return z + 1j * x


def ground_of(points: Float[np.ndarray, "*any 3"]) -> Complex[np.ndarray, "*any"]:
    """Return where the points x, y, z are when seen from above."""
    return ground(points[..., 0], points[..., 2])


def current_gait(x: Float[np.ndarray, "row 342"]) -> Int64[np.ndarray, " row"]:
    """Return the gait of each input's own frame: the index in `layout.GAITS` of the highest."""
    gaits = np.stack([x[:, INPUT[f"gait_{gait}"]][:, NOW] for gait in GAITS], axis=1)
    highest: Int64[np.ndarray, " row"] = gaits.argmax(axis=1)
    return highest
