"""Predictors of motion that need no training: what a network must beat."""

from functools import partial

import numpy as np
import torch
from jaxtyping import Complex128, Float, Float64
from torch import Tensor

from addressed_dynamics.episodes.layout import FUTURE_OFFSETS, INPUT, JOINTS, OFFSETS, OUTPUT
from addressed_dynamics.simulators.motion_ground import JOINT_X, JOINT_Y, JOINT_Z, ground
from addressed_dynamics.simulators.motion_predictor import MotionPredictor

HIPS = JOINTS.index("Hips")


def mean_outputs(mean: Float[np.ndarray, " 311"]) -> MotionPredictor:
    """Return the predictor that always answers the mean outputs of training."""
    return partial(_constant, torch.from_numpy(np.asarray(mean, np.float32)))


def persistence_plus_velocity(mean: Float[np.ndarray, " 311"]) -> MotionPredictor:
    """Return the predictor that lets everything go on as it goes.

    An input holds the joints of the frame before, in the root before. Their velocities lead exactly to where they are
    now, and those of the hips to where the root is now; how far it turned meanwhile is read off the trajectory.
    Velocities stay as they are, and the trajectory is the given one, seen from a root one frame on. What cannot be
    known from the input (change of phase, contacts, rotations) is as on average.

    Args:
        mean: mean outputs of training.
    """
    return partial(_go_on, np.asarray(mean, np.float32))


def _constant(
    constant: Float[Tensor, " 311"],
    x: Float[Tensor, "row 342"],
    phase: Float[Tensor, " row"],  # noqa: ARG001 - a predictor is given it
) -> Float[Tensor, "row 311"]:
    return constant.repeat(len(x), 1)


def _go_on(
    constant: Float[np.ndarray, " 311"],
    x: Float[Tensor, "row 342"],
    phase: Float[Tensor, " row"],  # noqa: ARG001 - a predictor is given it
) -> Float[Tensor, "row 311"]:
    given = x.double().numpy()
    y = np.tile(constant, (len(x), 1))
    position = ground(given[:, INPUT.trajectory_position_x], given[:, INPUT.trajectory_position_z])
    direction = ground(given[:, INPUT.trajectory_direction_x], given[:, INPUT.trajectory_direction_z])
    joints, velocities = given[:, INPUT.joint_position], given[:, INPUT.joint_velocity]
    # Heading of the root before, and with it the turn from its frame to the present one.
    before = _unit(direction @ _AT_PREVIOUS)[:, None]
    velocity = before * ground(velocities[:, JOINT_X], velocities[:, JOINT_Z])
    root_step = velocity[:, HIPS, None]
    moved = before * ground(joints[:, JOINT_X], joints[:, JOINT_Z]) + velocity - root_step
    _set_joints(y[:, OUTPUT.joint_position], moved, joints[:, JOINT_Y] + velocities[:, JOINT_Y])
    _set_joints(y[:, OUTPUT.joint_velocity], velocity, velocities[:, JOINT_Y])

    heading = _unit(direction @ _AT_NEXT)[:, None]
    future = ((position @ _AT_FUTURE) - root_step) / heading
    future[:, 0] = 0.0
    facing = _unit(direction @ _AT_FUTURE) / heading
    y[:, OUTPUT.root_velocity] = np.concatenate([root_step.imag, root_step.real], axis=1)
    y[:, OUTPUT.root_turn] = -np.angle(heading)
    y[:, OUTPUT.trajectory_position_x], y[:, OUTPUT.trajectory_position_z] = future.imag, future.real
    y[:, OUTPUT.trajectory_direction_x], y[:, OUTPUT.trajectory_direction_z] = facing.imag, facing.real
    return torch.from_numpy(y)


def _set_joints(
    columns: Float[np.ndarray, "row 93"],
    seen_from_above: Complex128[np.ndarray, "row 31"],
    height: Float64[np.ndarray, "row 31"],
) -> None:
    columns[:, JOINT_X], columns[:, JOINT_Y], columns[:, JOINT_Z] = seen_from_above.imag, height, seen_from_above.real


def _unit(direction: Complex128[np.ndarray, "*any"]) -> Complex128[np.ndarray, "*any"]:
    unit: Complex128[np.ndarray, "*any"] = direction / np.maximum(np.abs(direction), 1e-8)
    return unit


def _interpolation(offset: float) -> Complex128[np.ndarray, " sample"]:
    """Return weights of the samples of a trajectory that give its value at `offset` by the cubic through four of them.

    Beyond the last sample the cubic goes on.
    """
    samples = np.array(OFFSETS, np.float64)
    first = int(np.clip(np.searchsorted(samples, offset) - 2, 0, len(samples) - 4))
    weights = np.zeros(len(samples), np.complex128)
    for index in range(first, first + 4):
        others = np.delete(samples[first : first + 4], index - first)
        weights[index] = np.prod((offset - others) / (samples[index] - others))
    return weights


_AT_PREVIOUS = _interpolation(-1.0)
_AT_NEXT = _interpolation(1.0)
_AT_FUTURE = np.stack([_interpolation(1.0 + offset) for offset in FUTURE_OFFSETS], axis=1)
