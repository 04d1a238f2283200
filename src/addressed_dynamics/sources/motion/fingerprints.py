"""Eight bytes that stand for a row of motion, by which equal rows are found among millions.

The idea is that of `episodes.fingerprints.row_fingerprints`, which takes a column at a time; a row here has 654.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Int64, UInt64

from addressed_dynamics.episodes.layout import INPUT, INPUT_HEIGHTS, OUTPUT

CHUNK = 128
"""Rows that are worked on at once: they stay in the processor's cache, which makes it five times faster."""

VERTICAL = slice(1, None, 3)
"""Every y among coordinates x, y, z."""


def _terrain_columns() -> tuple[Int64[np.ndarray, " column"], Int64[np.ndarray, " column"]]:
    """Return the columns of an input and of an output that depend on the terrain.

    A cycle is written once for each patch of terrain that fits it: the patch gives the heights, and its own height
    is taken from that of the joints.
    """
    x, y = np.arange(INPUT.width), np.arange(OUTPUT.width)
    heights = x[INPUT_HEIGHTS]
    return np.concatenate([x[INPUT.joint_position][VERTICAL], heights]), y[OUTPUT.joint_position][VERTICAL]


X_TERRAIN, Y_TERRAIN = _terrain_columns()
"""Columns of an input and of an output in which copies of a frame on other terrain differ."""
X_MOTION, Y_MOTION = np.setdiff1d(np.arange(INPUT.width), X_TERRAIN), np.setdiff1d(np.arange(OUTPUT.width), Y_TERRAIN)
"""The other columns: the motion itself, equal bit for bit on every terrain."""


def motion_fingerprints(
    x: Float32[np.ndarray, "row 342"], y: Float32[np.ndarray, "row 311"]
) -> UInt64[np.ndarray, " row"]:
    """Return a fingerprint of each row's motion, whatever the terrain and the phase."""
    return _fingerprints([x, y], [X_MOTION, Y_MOTION])


def terrain_fingerprints(
    x: Float32[np.ndarray, "row 342"], y: Float32[np.ndarray, "row 311"]
) -> UInt64[np.ndarray, " row"]:
    """Return a fingerprint of what the terrain makes of each row."""
    return _fingerprints([x, y], [X_TERRAIN, Y_TERRAIN])


def window_fingerprints(windows: Float32[np.ndarray, "window frame"]) -> UInt64[np.ndarray, " window"]:
    """Return a fingerprint of each short run of values."""
    return _fingerprints([windows], [np.arange(windows.shape[1])])


def phase_fingerprints(phase: Float32[np.ndarray, " row"]) -> UInt64[np.ndarray, " row"]:
    """Return a fingerprint of each phase."""
    return _fingerprints([phase[:, None]], [np.arange(1)])


def _fingerprints(
    parts: Sequence[Float32[np.ndarray, "row column"]], columns: Sequence[Int64[np.ndarray, " column"]]
) -> UInt64[np.ndarray, " row"]:
    """Return 64 bits for each row that are equal for rows of equal bits, and differ for others but for rare chance.

    Among ten million rows that chance is 3e-6. Two columns at a time are mixed as one number with a key of their
    place, and the results are added.
    """
    rows, width = len(parts[0]), sum(map(len, columns))
    pairs = -(-width // 2)
    keys = _mixed(np.arange(1, pairs + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15))
    values = np.zeros((CHUNK, 2 * pairs), dtype=np.float32)
    fingerprints = np.empty(rows, dtype=np.uint64)
    for start in range(0, rows, CHUNK):
        size, stop, left = min(CHUNK, rows - start), start + CHUNK, 0
        for part, taken in zip(parts, columns, strict=True):
            values[:size, left : left + len(taken)] = part[start:stop].take(taken, axis=1)
            left += len(taken)
        fingerprints[start:stop] = _mixed(values[:size].view(np.uint64) + keys).sum(axis=1)
    return fingerprints


def _mixed(values: UInt64[np.ndarray, "*shape"]) -> UInt64[np.ndarray, "*shape"]:
    """Mix `values` in place: the finaliser of SplitMix64 (Steele, Lea and Flood, 2014)."""
    shifted = values >> np.uint64(30)
    values ^= shifted
    values *= np.uint64(0xBF58476D1CE4E5B9)
    np.right_shift(values, np.uint64(27), out=shifted)
    values ^= shifted
    values *= np.uint64(0x94D049BB133111EB)
    np.right_shift(values, np.uint64(31), out=shifted)
    values ^= shifted
    return values
