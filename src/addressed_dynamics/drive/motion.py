"""Drives of characters: a model of motion in the closed loop under a person's commands, and a PFNN under the same."""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float32

from addressed_dynamics.base.errors import DriveError, ModelError
from addressed_dynamics.drive.finding import Named
from addressed_dynamics.drive.protocol import AnyMessage, Command
from addressed_dynamics.drive.recorder import DriveRecorder, Recorded, imagined_by_hand
from addressed_dynamics.drive.session import Said, Session, plain
from addressed_dynamics.episodes.layout import FRAME_RATE, JOINTS, OUTPUT
from addressed_dynamics.episodes.transitions import Dimension, SpaceSpec
from addressed_dynamics.logs import RunInfo
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_controller import (
    NOW,
    SLOWEST,
    Commands,
    State,
    joints_in_world,
    reset,
)
from addressed_dynamics.simulators.motion_environment import COMMANDS
from addressed_dynamics.simulators.motion_loop import LoopFrame, loop_frame, mean_pose

PFNN = "phase_functioned"
"""Name of the candidate that stands beside the others."""
TURNS = 110.0
"""Degrees that the facing turns in a second if all of it is asked for."""
JOG = 0.7
"""What jogging adds to the speed of walking, as a share of it."""
_TOUCHES = 0.5
_UNBOUNDED = (-math.inf, math.inf)
SPACES = SpaceSpec(
    observation=(
        *(Dimension(f"root_{axis}", "cm", *_UNBOUNDED) for axis in "xz"),
        *(Dimension(f"facing_{axis}", "", -1.0, 1.0) for axis in "xz"),
        *(Dimension(f"{joint}_{axis}", "cm", *_UNBOUNDED) for joint in JOINTS for axis in "xyz"),
    ),
    action=COMMANDS,
    step_seconds=1 / FRAME_RATE,
)
"""What a log of a driven character holds: where it is in the world, and what was asked of it."""


@dataclass(frozen=True)
class DrivenMotion:
    """What all pages drive: a model of motion, and perhaps a PFNN beside it."""

    title: str
    folder: Path
    model: MotionModel
    beside: MotionModel | None
    names: tuple[str, ...]
    """What the models are called in the page."""

    @staticmethod
    def load(named: Named, candidate: str | None = None) -> DrivenMotion:
        """Load a model, and the published PFNN if the params name one, else the one that was trained beside it.

        Raises:
            ModelError: there is no such model, or the published one is damaged.
        """
        model = MotionModel.load(named.folder, candidate=candidate)
        beside, name = _beside(named, model)
        own = "PFNN" if model.mode == "phase" else "model"
        return DrivenMotion(named.title, named.folder, model, beside, (own, name) if beside else (own,))

    def session(self, _page: int, folder: Path) -> MotionSession:
        """Return a drive of its own for a page; its recordings go into `folder`."""
        return MotionSession(self, folder)


def _beside(named: Named, model: MotionModel) -> tuple[MotionModel | None, str]:
    if named.released is not None and named.released.exists():
        return MotionModel.load_released(named.released), "PFNN, as published"
    if model.mode == "phase":
        return None, ""
    try:
        return MotionModel.load(named.folder, candidate=PFNN), "PFNN, trained as long"
    except ModelError:
        return None, ""


class MotionSession(Session):
    """One page's drive of a character, and of its double."""

    step_seconds = 1 / FRAME_RATE

    def __init__(self, driven: DrivenMotion, folder: Path) -> None:
        """Begin it.

        Args:
            driven: who is driven.
            folder: where recordings go.
        """
        super().__init__(DriveRecorder(folder, SPACES))
        self._driven = driven
        models = (driven.model, *([driven.beside] if driven.beside else []))
        self._predictors = {
            name: model.predictor(generator=torch.Generator().manual_seed(0))
            for name, model in zip(driven.names, models, strict=True)
        }
        self._start = mean_pose(driven.model.features)
        runs = len(self._predictors)
        self._step = 0
        self._asked = Command(type="command")
        self._facing = 1.0 + 0.0j
        """Where a person looks, and what they ask for is seen from."""
        self._alive = np.ones(runs, np.bool_)
        self._state: State = reset(self._start, np.ones(runs, np.complex128))
        self._shown = self._state

    def hello(self) -> Said:
        """Return who there is and what they are made of."""
        model = self._driven.model
        return {
            "type": "hello",
            "kind": "motion",
            "title": self._driven.title,
            "model": _words(model),
            "environment": None,
            "bodies": list(self._driven.names),
            "joints": list(JOINTS),
            "members": 1 if model.mode == "phase" else model.networks.members,
            "step_seconds": self.step_seconds,
            "rate": self.rate,
        }

    def reset(self) -> Said:
        """Let everybody stand at the origin in the mean pose, looking along z."""
        self.begin_episode(None)
        self._step, self._facing, self._asked = 0, 1.0 + 0.0j, Command(type="command")
        self._alive[:] = True
        self._state = self._shown = reset(self._start, np.ones(len(self._alive), np.complex128))
        return {**self._frame(None), "start": True}

    def step(self) -> Said:
        """Advance everybody by a frame."""
        self._facing *= cmath.exp(1j * math.radians(TURNS) / FRAME_RATE * self._asked.turn)
        commands = self._commands()
        before, lived = self._seen(0), bool(self._alive[0])
        with torch.inference_mode():
            seen = loop_frame(self._predictors, self._state, commands, self._alive)
        self._state, self._alive, self._shown = seen.after, seen.alive, seen.shown
        if lived and self._alive[0]:
            velocity, facing = complex(commands.velocity[0]), self._facing
            action = [velocity.imag, velocity.real, facing.imag, facing.real]
            action += [self._asked.run, self._asked.strafe, self._asked.crouch]
            self.record(Recorded(self._step, before, action, 0.0, self._seen(0)))
        self._step += 1
        return self._frame(seen)

    def take(self, message: AnyMessage) -> Said | None:
        """Ask something of the characters from now on.

        Raises:
            DriveError: it is nothing that one asks of a character.
        """
        if not isinstance(message, Command):
            refusal = f"a character knows no '{message.type}'; it is told by 'command'"
            raise DriveError(refusal)
        self._asked = message
        return None

    def run_info(self) -> RunInfo:
        """Return what a recording says of itself: that it is what a model predicts."""
        model = self._driven.model
        return imagined_by_hand(self._driven.folder, model.origin, model.mode)

    def _commands(self) -> Commands:
        """Return what is asked, seen in the world, of everybody."""
        asked, runs = self._asked, len(self._predictors)
        # Left is towards +i: the heading is the angle from z to x, and turning left raises it.
        stick = complex(asked.ahead, -asked.right)
        stick /= max(1.0, abs(stick))
        velocity = SLOWEST * (1.0 + JOG * asked.run) * stick * self._facing
        return Commands(
            velocity=np.full(runs, velocity),
            facing=np.full(runs, self._facing),
            jogging=np.full(runs, asked.run > 0.0),
            strafe=np.full(runs, asked.strafe),
            crouch=np.full(runs, asked.crouch),
        )

    def _seen(self, run: int) -> Float32[np.ndarray, " observation"]:
        """Return where a character is, as a log has it."""
        root, heading = complex(self._shown.root[run]), complex(self._shown.heading[run])
        place = np.array([root.imag, root.real, heading.imag, heading.real], np.float32)
        return np.concatenate([place, joints_in_world(self._shown)[run].reshape(-1)])

    def _frame(self, seen: LoopFrame | None) -> Said:
        """Return what there is to see."""
        joints, command = joints_in_world(self._shown), complex(self._commands().velocity[0])
        bodies = [
            {
                "joints": plain(joints[run].reshape(-1).round(1), 6),
                "root": plain([self._shown.root[run].imag, self._shown.root[run].real], 6),
                "touching": [] if seen is None else (seen.y[run, OUTPUT.contact] > _TOUCHES).tolist(),
                "speed": round(_speed(self._shown, run), 3),
                "alive": bool(self._alive[run]),
            }
            for run in range(len(joints))
        ]
        return {
            "type": "frame",
            "step": self._step,
            "bodies": bodies,
            "command": plain([command.imag, command.real], 5),
            "facing": round(cmath.phase(self._facing), 4),
            "weights": None if seen is None else self._weights(seen),
            "ended": "",
            "recorded": self.recorder.count if self.recorder.recording else None,
        }

    def _weights(self, seen: LoopFrame) -> list[float | None] | None:
        model = self._driven.model
        if model.mode == "phase" or model.addressing is None or not self._alive[0]:
            return None
        return plain(model.probabilities(torch.from_numpy(seen.x[:1]).float())[0].numpy(), 3)


def _speed(state: State, run: int, frames: int = 12) -> float:
    """Return how fast a root went over the ground in the last frames, in m/s."""
    way = abs(complex(state.position[run, NOW] - state.position[run, NOW - frames]))
    return way * FRAME_RATE / (100 * frames)


def _words(model: MotionModel) -> str:
    networks = "a single network" if model.networks.members == 1 else f"{model.networks.members} networks, {model.mode}"
    return f"{model.origin}: {networks}" if model.origin else networks
