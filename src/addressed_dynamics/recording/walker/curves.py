"""Smooth curves over the frames of a clip, and turns about the axes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

RATE = 120
"""Frames per second of a clip's files."""

Curve = Float64[np.ndarray, " frame"]
"""One value a frame."""
Vectors = Float64[np.ndarray, "frame 3"]
"""A place in cm or a direction, y upwards."""
Turns = Float64[np.ndarray, "frame 3 3"]
"""A rotation a frame, as the matrix that turns columns."""


def smooth(values: Curve, seconds: float) -> Curve:
    """Return `values` under a Gaussian whose standard deviation is `seconds`; the ends go on as they are."""
    reach = round(3 * seconds * RATE)
    kernel = np.exp(-0.5 * (np.arange(-reach, reach + 1) / (seconds * RATE)) ** 2)
    padded = np.pad(values, reach, mode="edge")
    result: Curve = np.convolve(padded, kernel / kernel.sum(), mode="valid")
    return result


def drift(frames: int, seconds: float, generator: np.random.Generator) -> Curve:
    """Return smooth noise of mean 0 and variance 1 that changes over about `seconds`."""
    reach = round(3 * seconds * RATE)
    noise = smooth(generator.normal(size=frames + 2 * reach), seconds)[reach : reach + frames]
    # The variance of white noise under a Gaussian of s frames is 1 / (2 s √π).
    result: Curve = noise * np.sqrt(2 * np.sqrt(np.pi) * seconds * RATE)
    return result


def lowest_around(values: Curve, reach: int) -> Curve:
    """Return the lowest of `values` within `reach` frames."""
    windows = np.lib.stride_tricks.sliding_window_view(np.pad(values, reach, mode="edge"), 2 * reach + 1)
    result: Curve = windows.min(axis=1)
    return result


def through(
    at: Curve, knots: Float64[np.ndarray, " knot"], values: Float64[np.ndarray, " knot"]
) -> Float64[np.ndarray, " frame"]:
    """Return the curve through (`knots`, `values`) at the places `at`; it rises and falls only where the values do.

    Cubic pieces whose slope at a knot is the harmonic mean of the slopes beside it, and 0 where those differ in sign
    (Fritsch and Butland, 1984); 0 at the ends, too.
    """
    steps = np.diff(knots)
    slopes = np.diff(values) / steps
    product = slopes[:-1] * slopes[1:]
    total = slopes[:-1] + slopes[1:]
    inner = np.where(product > 0, 2 * product / np.where(product > 0, total, 1.0), 0.0)
    tangents = np.concatenate([[0.0], inner, [0.0]])
    piece = np.clip(np.searchsorted(knots, at, side="right") - 1, 0, len(steps) - 1)
    share = np.clip((at - knots[piece]) / steps[piece], 0.0, 1.0)
    rise = share**2 * (3 - 2 * share)
    result: Curve = (
        values[piece] * (1 - rise)
        + values[piece + 1] * rise
        + steps[piece] * share * (1 - share) * (tangents[piece] * (1 - share) - tangents[piece + 1] * share)
    )
    return result


def about_x(angle: Curve) -> Turns:
    """Return turns about the x axis, by angles in rad; y goes to z."""
    return _turns(angle, 1, 2)


def about_y(angle: Curve) -> Turns:
    """Return turns about the y axis, by angles in rad; z goes to x."""
    return _turns(angle, 2, 0)


def about_z(angle: Curve) -> Turns:
    """Return turns about the z axis, by angles in rad; x goes to y."""
    return _turns(angle, 0, 1)


def _turns(angle: Curve, first: int, second: int) -> Turns:
    turns = np.tile(np.eye(3), (len(angle), 1, 1))
    turns[:, first, first] = turns[:, second, second] = np.cos(angle)
    turns[:, second, first] = np.sin(angle)
    turns[:, first, second] = -turns[:, second, first]
    return turns


def angles_of(turns: Float64[np.ndarray, "*any 3 3"]) -> Float64[np.ndarray, "*any 3"]:
    """Return angles in rad about x, y and z whose turns, in this order, make `turns`."""
    x = np.arctan2(turns[..., 2, 1], turns[..., 2, 2])
    y = np.arctan2(-turns[..., 2, 0], np.hypot(turns[..., 0, 0], turns[..., 1, 0]))
    z = np.arctan2(turns[..., 1, 0], turns[..., 0, 0])
    return np.stack([x, y, z], axis=-1)
