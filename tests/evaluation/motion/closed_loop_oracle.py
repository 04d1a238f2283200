"""The published controller followed entry by entry, for one run: angles, loops and three-dimensional vectors."""

import math
from typing import Any

import numpy as np
import torch

from addressed_dynamics.episodes.layout import GAITS, INPUT, OUTPUT
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script
from addressed_dynamics.simulators.motion_controller import Pose
from addressed_dynamics.simulators.motion_predictor import MotionPredictor


def rotation(angle: float) -> np.ndarray:
    """About the y axis: z turns towards x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def turned(start: float, end: float, share: float) -> float:
    apart = (end - start + math.pi) % (2 * math.pi) - math.pi
    return start + share * apart


def angle_of(direction: complex) -> float:
    return math.atan2(direction.imag, direction.real)


def vector(number: complex) -> np.ndarray:
    return np.array([number.imag, 0.0, number.real])


def run_by_loops(predictor: MotionPredictor, script: Script, pose: Pose) -> dict[str, np.ndarray]:
    """Positions of root and joints, headings and phases of every frame."""
    start = angle_of(script.facing[0])
    position = [np.zeros(3) for _ in range(120)]
    angle = [start] * 120
    gait = [np.zeros(6) for _ in range(120)]
    velocity, target, phase = np.zeros(3), start, 0.0
    joints = pose.position @ rotation(start).T
    joint_velocity = pose.velocity @ rotation(start).T
    trace: dict[str, list[Any]] = {"joints": [], "root": [], "heading": [], "phase": []}
    for frame in range(len(script)):
        facing, strafe = angle_of(script.facing[frame]), script.strafe[frame]
        velocity = 0.1 * velocity + 0.9 * vector(script.velocity[frame])
        speed = np.linalg.norm(velocity)
        ahead = facing if speed < 1e-5 else math.atan2(velocity[0], velocity[2])
        target = turned(target, turned(ahead, facing, strafe), 0.9)
        wanted = np.zeros(6)
        if speed < 0.1:
            wanted[GAITS.index("stand")] = 1.0
        elif script.crouch[frame] > 0.1:
            wanted[GAITS.index("crouch")] = script.crouch[frame]
        else:
            wanted[GAITS.index("jog" if script.run[frame] > -1 else "walk")] = 1.0
        gait[60] = 0.9 * gait[60] + 0.1 * wanted
        future = [position[60]]
        for i in range(61, 120):
            left = 1 - (i - 60) / 60
            share = 1 - left ** (0.5 + strafe * (1.0 - 0.5))
            future.append(future[-1] + (1 - share) * (position[i] - position[i - 1]) + share * velocity)
            angle[i] = turned(angle[i], target, 1 - left ** (2.0 + strafe * (0.5 - 2.0)))
            gait[i] = gait[60]
        position[60:] = future

        y = predictor(torch.tensor(given(position, angle, gait, joints, joint_velocity))[None].float(),
                      torch.tensor([phase]).float())[0].double().numpy()  # fmt: skip
        to_world = rotation(angle[60])
        joint_velocity = y[OUTPUT.joint_velocity].reshape(31, 3) @ to_world.T
        predicted = y[OUTPUT.joint_position].reshape(31, 3) @ to_world.T + position[60]
        joints = 0.5 * (joints + joint_velocity) + 0.5 * predicted
        for name, value in {"joints": joints, "root": position[60], "heading": angle[60], "phase": phase}.items():
            trace[name].append(np.array(value))

        for i in range(60):
            position[i], angle[i], gait[i] = position[i + 1], angle[i + 1], gait[i + 1]
        moving = (1 - gait[60][0]) ** 0.25
        x_step, z_step = y[OUTPUT.root_velocity]
        position[60] = position[60] + moving * to_world @ np.array([x_step, 0.0, z_step])
        angle[60] = angle[60] - moving * y[OUTPUT.root_turn][0]
        for i in range(61, 120):
            sample, share = divmod(i - 60, 10)
            if sample < 5:
                ahead_x, ahead_z, facing_x, facing_z = (
                    (1 - share / 10) * y[OUTPUT[name]][sample] + share / 10 * y[OUTPUT[name]][sample + 1]
                    for name in (
                        "trajectory_position_x", "trajectory_position_z",
                        "trajectory_direction_x", "trajectory_direction_z",
                    )
                )  # fmt: skip
            elif not share:
                ahead_x, ahead_z = (y[OUTPUT[f"trajectory_position_{axis}"]][5] for axis in "xz")
                facing_x, facing_z = (y[OUTPUT[f"trajectory_direction_{axis}"]][5] for axis in "xz")
            position[i] = position[60] + rotation(angle[60]) @ np.array([ahead_x, 0.0, ahead_z])
            angle[i] = angle[60] + math.atan2(facing_x, facing_z)
        phase = (phase + (0.9 * moving + 0.1) * y[OUTPUT.phase_change][0]) % 1.0
    return {name: np.array(values) for name, values in trace.items()}


def given(
    position: list[np.ndarray],
    angle: list[float],
    gait: list[np.ndarray],
    joints: np.ndarray,
    joint_velocity: np.ndarray,
) -> np.ndarray:
    """The input: 12 samples of the trajectory in root 60, joints in root 59."""
    x = np.zeros(INPUT.width)
    back, before = rotation(-angle[60]), rotation(-angle[59])
    for sample, i in enumerate(range(0, 120, 10)):
        x[INPUT.trajectory_position_x][sample], _, x[INPUT.trajectory_position_z][sample] = back @ (
            position[i] - position[60]
        )
        x[INPUT.trajectory_direction_x][sample] = math.sin(angle[i] - angle[60])
        x[INPUT.trajectory_direction_z][sample] = math.cos(angle[i] - angle[60])
        for index, name in enumerate(GAITS):
            x[INPUT[f"gait_{name}"]][sample] = gait[i][index]
    x[INPUT.joint_position] = ((joints - position[59]) @ before.T).ravel()
    x[INPUT.joint_velocity] = (joint_velocity @ before.T).ravel()
    return x
