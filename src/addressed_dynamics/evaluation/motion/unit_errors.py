"""Errors of predicted motion as one would measure them: distances, speeds and angles, block by block."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.episodes.layout import FRAME_RATE, OUTPUT

Values = Float64[np.ndarray, "row 311"]
Errors = Float64[np.ndarray, " row"]


@dataclass(frozen=True)
class UnitError:
    """Mean error of what one or two blocks of outputs say."""

    name: str
    """A block of `layout.OUTPUT`; `trajectory_position` and `trajectory_direction` are two of them."""
    unit: str
    value: float


def unit_errors(predicted: Values, true: Values) -> dict[str, Errors]:
    """Return the error of each row in each of `UNITS`: the mean over joints, feet or points of the trajectory."""
    return {name: measure(predicted, true) for name, (_, measure) in _MEASURES.items()}


def _lengths(name: str, axes: int, times: float = 1.0) -> Callable[[Values, Values], Errors]:
    """Measure how long the difference of vectors is, in multiples of the block's unit."""

    def measure(predicted: Values, true: Values) -> Errors:
        error = (predicted - true)[:, OUTPUT[name]].reshape(len(true), -1, axes)
        lengths: Errors = times * np.linalg.norm(error, axis=-1).mean(axis=1)
        return lengths

    return measure


def _wrong_contacts(predicted: Values, true: Values) -> Errors:
    says, touches = (values[:, OUTPUT.contact] > 0.5 for values in (predicted, true))
    wrong: Errors = 100.0 * (says != touches).mean(axis=1)
    return wrong


def _trajectory_distance(predicted: Values, true: Values) -> Errors:
    error = predicted - true
    x, z = (error[:, OUTPUT[f"trajectory_position_{axis}"]] for axis in "xz")
    distance: Errors = np.hypot(x, z).mean(axis=1)
    return distance


def _trajectory_angle(predicted: Values, true: Values) -> Errors:
    found, right = (
        values[:, OUTPUT.trajectory_direction_z] + 1j * values[:, OUTPUT.trajectory_direction_x]
        for values in (predicted, true)
    )
    angles: Errors = np.degrees(np.abs(np.angle(found * right.conj()))).mean(axis=1)
    return angles


def _rotation_angle(predicted: Values, true: Values) -> Errors:
    """Measure the angle of the turn from one orientation to the other; columns are logarithms of quaternions."""
    found, right = (_quaternions(values[:, OUTPUT.joint_rotation]) for values in (predicted, true))
    cosine = np.abs((found * right).sum(axis=-1)).clip(max=1.0)
    angles: Errors = np.degrees(2.0 * np.arccos(cosine)).mean(axis=1)
    return angles


def _quaternions(logarithms: Float64[np.ndarray, "row column"]) -> Float64[np.ndarray, "row joint 4"]:
    vector = logarithms.reshape(len(logarithms), -1, 3)
    half = np.linalg.norm(vector, axis=-1, keepdims=True)
    # sinc is sin(pi t) / (pi t), and 1 at 0.
    return np.concatenate([np.cos(half), vector * np.sinc(half / np.pi)], axis=-1)


_MEASURES: Mapping[str, tuple[str, Callable[[Values, Values], Errors]]] = {
    "root_velocity": ("cm/s", _lengths("root_velocity", 2, FRAME_RATE)),
    "root_turn": ("degrees/s", _lengths("root_turn", 1, FRAME_RATE * 180.0 / np.pi)),
    "phase_change": ("cycles/s", _lengths("phase_change", 1, FRAME_RATE)),
    "contact": ("% wrong", _wrong_contacts),
    "trajectory_position": ("cm", _trajectory_distance),
    "trajectory_direction": ("degrees", _trajectory_angle),
    "joint_position": ("cm", _lengths("joint_position", 3)),
    "joint_velocity": ("cm/s", _lengths("joint_velocity", 3, FRAME_RATE)),
    "joint_rotation": ("degrees", _rotation_angle),
}
UNITS: Mapping[str, str] = {name: unit for name, (unit, _) in _MEASURES.items()}
"""Unit of each error."""
