"""Runs of the closed loop: models on their own predictions under scripts of commands."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Complex128, Float32, Float64, Int64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.base.threads import single_thread
from addressed_dynamics.episodes.layout import CONTACTS, JOINTS, OUTPUT
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.motion.closed_loop.commands import Script
from addressed_dynamics.simulators.motion_controller import (
    Commands,
    Pose,
    State,
    joints_in_world,
    reset,
)
from addressed_dynamics.simulators.motion_loop import loop_frame
from addressed_dynamics.simulators.motion_predictor import MotionPredictor


@dataclass(frozen=True)
class Trace:
    """What a model made of scripts of commands, one run a script. A dead run stays where it was."""

    scripts: tuple[Script, ...]
    joint_position: Float32[np.ndarray, "run frame 31 3"]
    """In the world: x, y, z in cm."""
    root: Complex128[np.ndarray, "run frame"]
    """Where the root is (`simulators.motion_ground`), in cm."""
    heading: Complex128[np.ndarray, "run frame"]
    """Where the root faces; 1 long."""
    contact: Float32[np.ndarray, "run frame 4"]
    """Predicted probability that a foot touches the ground, in the order of `layout.CONTACTS`."""
    phase: Float32[np.ndarray, "run frame"]
    """What the predictor was told of the phase, in [0, 1)."""
    lived: Int64[np.ndarray, " run"]
    """Frames before the run died; all if it did not."""

    @property
    def commanded(self) -> Complex128[np.ndarray, "run frame"]:
        """Velocity asked for, in cm/frame."""
        return np.stack([script.velocity for script in self.scripts])

    def arrays(self) -> dict[str, np.ndarray]:
        """Return what a figure or an animation needs, as arrays of real numbers: positions x, z and angles in rad."""
        return {
            "joint_position": self.joint_position,
            "root_position": np.stack([self.root.imag, self.root.real], axis=-1),
            "root_heading": np.angle(self.heading),
            "commanded_velocity": np.stack([self.commanded.imag, self.commanded.real], axis=-1),
            "contact": self.contact,
            "phase": self.phase,
            "lived": self.lived,
        }


def start_pose(motion: Motion) -> Pose:
    """Return the mean pose of recorded motion, with which the published controller begins.

    Raises:
        EvaluationError: the motion has no frames.
    """
    if not len(motion):
        message = "a closed loop begins with the mean pose of recorded motion, but the motion has no frames"
        raise EvaluationError(message)
    mean = motion.y.mean(axis=0, dtype=np.float64)
    return Pose(mean[OUTPUT.joint_position].reshape(-1, 3), mean[OUTPUT.joint_velocity].reshape(-1, 3))


def closed_loop(predictors: Mapping[str, MotionPredictor], scripts: Sequence[Script], start: Pose) -> dict[str, Trace]:
    """Run every predictor under every script; each run is as if it were alone.

    A run dies when an output is not finite or absurdly large, or when a joint flies off (`FARTHEST`).

    Args:
        predictors: the models, by name.
        scripts: commands, equally long.
        start: the pose in which all runs begin, at the origin, facing where the script does.

    Returns:
        A trace for each predictor.

    Raises:
        EvaluationError: there is nothing to run, the scripts differ in length, or a predictor returns another shape.
    """
    if not predictors or not scripts or len({len(script) for script in scripts}) != 1:
        lengths = ", ".join(str(len(script)) for script in scripts) or "none"
        message = (
            f"a closed loop needs predictors (found {len(predictors)}) and scripts of equal length (frames: {lengths})"
        )
        raise EvaluationError(message)
    frames, rows = len(scripts[0]), len(predictors) * len(scripts)
    commands = _commands(scripts, len(predictors))
    recorder = _Recorder(rows, frames)
    state = reset(start, np.tile([script.facing[0] for script in scripts], len(predictors)))
    alive = np.ones(rows, np.bool_)
    with torch.inference_mode(), single_thread():
        for frame in range(frames):
            seen = loop_frame(predictors, state, _at(commands, frame), alive)
            recorder.record(frame, seen.shown, seen.y, seen.phase, seen.alive)
            state, alive = seen.after, seen.alive
    return {
        name: recorder.trace(tuple(scripts), slice(index * len(scripts), (index + 1) * len(scripts)))
        for index, name in enumerate(predictors)
    }


class _Recorder:
    """The traces of all runs, filled frame by frame."""

    def __init__(self, rows: int, frames: int) -> None:
        self._joint_position = np.zeros((rows, frames, len(JOINTS), 3), np.float32)
        self._root = np.zeros((rows, frames), np.complex128)
        self._heading = np.zeros((rows, frames), np.complex128)
        self._contact = np.zeros((rows, frames, len(CONTACTS)), np.float32)
        self._phase = np.zeros((rows, frames), np.float32)
        self._lived = np.zeros(rows, np.int64)

    def record(
        self,
        frame: int,
        state: State,
        y: Float64[np.ndarray, "run 311"],
        phase: Float32[np.ndarray, " run"],
        alive: Bool[np.ndarray, " run"],
    ) -> None:
        self._joint_position[:, frame] = joints_in_world(state)
        self._root[:, frame] = state.root
        self._heading[:, frame] = state.heading
        self._contact[:, frame] = y[:, OUTPUT.contact]
        self._phase[:, frame] = phase
        self._lived += alive

    def trace(self, scripts: tuple[Script, ...], rows: slice) -> Trace:
        return Trace(
            scripts,
            self._joint_position[rows],
            self._root[rows],
            self._heading[rows],
            self._contact[rows],
            self._phase[rows],
            self._lived[rows],
        )


def _commands(scripts: Sequence[Script], times: int) -> Commands:
    """Return the commands of all runs, frame by frame: arrays (frame, run)."""

    def column(values: Sequence[np.ndarray]) -> np.ndarray:
        return np.tile(np.stack(values, axis=1), (1, times))

    return Commands(
        velocity=column([script.velocity for script in scripts]),
        facing=column([script.facing for script in scripts]),
        jogging=column([script.run > -1.0 for script in scripts]),
        strafe=column([script.strafe for script in scripts]),
        crouch=column([script.crouch for script in scripts]),
    )


def _at(commands: Commands, frame: int) -> Commands:
    return Commands(
        commands.velocity[frame],
        commands.facing[frame],
        commands.jogging[frame],
        commands.strafe[frame],
        commands.crouch[frame],
    )
