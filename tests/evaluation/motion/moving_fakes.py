"""Predictors of motion that are no networks, and the pose they begin in."""

import numpy as np
import torch
from torch import Tensor

from addressed_dynamics.episodes.layout import FUTURE_OFFSETS, INPUT, JOINTS, OUTPUT
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script
from addressed_dynamics.evaluation.motion.closed_loop.measures import GaitReference, MotionReference, bone_lengths
from addressed_dynamics.simulators.motion_controller import Pose
from addressed_dynamics.simulators.motion_predictor import MotionPredictor


def a_pose() -> Pose:
    """Joints all over the place, within a metre, with the hips above the root."""
    position = np.random.default_rng(0).normal(0.0, 20.0, (31, 3))
    position[:, 1] += 90.0
    position[0] = [0.0, 90.0, 0.0]
    return Pose(position, np.zeros((31, 3)))


def reference_of(pose: Pose) -> MotionReference:
    """A reference whose bones are those of the pose, with hips between 80 and 100 cm."""
    gait = GaitReference("all", 1, 100.0, 60.0, 3.0, 3.0, 0.2)
    lengths = bone_lengths(pose.position[None])[0]
    return MotionReference((gait,), (0.0, *lengths.tolist()), 80.0, 100.0)


def steady(pose: Pose, *, forward: float = 0.0, turn: float = 0.0, phase: float = 0.0) -> MotionPredictor:
    """A pose that slides forward (cm/frame), turns left (rad/frame), and plans to go on straight."""
    y = torch.zeros(OUTPUT.width)
    y[OUTPUT.root_velocity] = torch.tensor([0.0, forward])
    y[OUTPUT.root_turn], y[OUTPUT.phase_change] = -turn, phase
    y[OUTPUT.trajectory_position_z] = forward * torch.tensor(FUTURE_OFFSETS).float()
    y[OUTPUT.trajectory_direction_z] = 1.0
    y[OUTPUT.joint_position] = torch.from_numpy(pose.position).float().ravel()
    y[OUTPUT.joint_velocity] = torch.tensor([0.0, 0.0, forward]).repeat(len(JOINTS))
    return lambda x, _: y.repeat(len(x), 1)


def lively(pose: Pose, seed: int = 0) -> MotionPredictor:
    """A smooth function of all inputs and the phase that does something different in every column."""
    generator = np.random.default_rng(seed)
    weight = torch.from_numpy(generator.normal(0.0, 0.05, (INPUT.width, OUTPUT.width)))
    base = steady(pose, forward=1.5, turn=0.02, phase=0.03)

    def predict(x: Tensor, phase: Tensor) -> Tensor:
        scaled = torch.tanh(x.double() / 50.0) @ weight
        return base(x, phase) + 0.3 * torch.sin(scaled + 6.28 * phase.double()[:, None])

    return predict


def follower(script: Script, pose: Pose) -> MotionPredictor:
    """A pose that slides exactly as commanded; for one run of a script that never asks to stand."""
    frame, heading = iter(range(len(script))), [script.facing[0]]

    def predict(x: Tensor, phase: Tensor) -> Tensor:
        at = next(frame)
        y = steady(pose)(x, phase)
        step = script.velocity[at] * np.conj(heading[0])
        ahead = script.facing[min(at + 1, len(script) - 1)]
        y[:, OUTPUT.root_velocity] = torch.tensor([step.imag, step.real]).float()
        y[:, OUTPUT.root_turn] = -float(np.angle(ahead * np.conj(heading[0])))
        y[:, OUTPUT.joint_velocity] = torch.tensor([step.imag, 0.0, step.real]).float().repeat(len(JOINTS))
        heading[0] = ahead
        return y

    return predict


def failing(after: int, value: float, otherwise: MotionPredictor) -> MotionPredictor:
    """What answers `value` in one column from a frame on."""
    calls = iter(range(10**9))

    def predict(x: Tensor, phase: Tensor) -> Tensor:
        y = otherwise(x, phase).clone()
        if next(calls) >= after:
            y[:, OUTPUT.joint_position.start + 7] = value
        return y

    return predict
