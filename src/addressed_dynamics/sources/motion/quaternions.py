"""Rotations as unit quaternions: arrays whose last axis is w, x, y, z."""

from __future__ import annotations

from functools import reduce

import numpy as np
from jaxtyping import Float64


def multiply(left: Float64[np.ndarray, "*n 4"], right: Float64[np.ndarray, "*n 4"]) -> Float64[np.ndarray, "*n 4"]:
    """Return the product: the rotation that turns by `right` first and by `left` then."""
    a, b, c, d = np.moveaxis(left, -1, 0)
    w, x, y, z = np.moveaxis(right, -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def rotate(rotation: Float64[np.ndarray, "*n 4"], vector: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 3"]:
    """Return `vector`, turned by `rotation`."""
    w, x, y, z = np.moveaxis(rotation, -1, 0)
    p, q, r = np.moveaxis(vector, -1, 0)
    # v + 2w (u x v) + 2 u x (u x v), where u is the imaginary part: half the work of two products.
    s, t, u = 2 * (y * r - z * q), 2 * (z * p - x * r), 2 * (x * q - y * p)
    return np.stack(
        [p + w * s + y * u - z * t, q + w * t + z * s - x * u, r + w * u + x * t - y * s],
        axis=-1,
    )


def about(axis: int, angle: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n 4"]:
    """Return rotations by `angle` (rad) about the x (0), y (1) or z (2) axis."""
    rotation = np.zeros((*angle.shape, 4))
    rotation[..., 0] = np.cos(angle / 2)
    rotation[..., 1 + axis] = np.sin(angle / 2)
    return rotation


def from_euler(angles: Float64[np.ndarray, "*n 3"], order: str) -> Float64[np.ndarray, "*n 4"]:
    """Return the rotation of a joint in a BVH file.

    Args:
        angles: about x, y and z, in rad.
        order: the axes as the file lists them, for instance 'zyx'. The last is turned about first. It is empty for a
            joint that does not turn.
    """
    turns = [about(axis, angles[..., axis]) for axis in ("xyz".index(name) for name in order)]
    return reduce(multiply, turns or [about(0, np.zeros(angles.shape[:-1]))])


def between(start: Float64[np.ndarray, "*n 3"], end: Float64[np.ndarray, "*n 3"]) -> Float64[np.ndarray, "*n 4"]:
    """Return the shortest rotation that takes the direction `start` to the direction `end`.

    Of opposite directions, which leave the axis open, one at a right angle to `start` is chosen.
    """
    lengths = np.linalg.norm(start, axis=-1) * np.linalg.norm(end, axis=-1)
    rotation = np.concatenate([(lengths + (start * end).sum(axis=-1))[..., None], np.cross(start, end)], axis=-1)
    opposite = np.linalg.norm(rotation, axis=-1) <= 1e-12 * lengths
    if opposite.any():
        smallest = np.eye(3)[np.abs(start[opposite]).argmin(axis=-1)]
        rotation[opposite, 1:] = np.cross(start[opposite], smallest)
    unit: Float64[np.ndarray, "*n 4"] = rotation / np.linalg.norm(rotation, axis=-1, keepdims=True)
    return unit


def logarithm(rotation: Float64[np.ndarray, "*n 4"]) -> Float64[np.ndarray, "*n 3"]:
    """Return the axis of each rotation, as long as half its angle (rad), which is taken from [0, pi]."""
    positive = np.where(rotation[..., :1] < 0, -rotation, rotation)
    sine = np.linalg.norm(positive[..., 1:], axis=-1, keepdims=True)
    half_angle = np.arctan2(sine, positive[..., :1])
    # Half an angle per its sine is 1 where both vanish.
    scale = np.divide(half_angle, sine, out=np.ones_like(sine), where=sine > 1e-12)
    logarithms: Float64[np.ndarray, "*n 3"] = positive[..., 1:] * scale
    return logarithms
