"""A model of motion as an environment: commands are the actions, and a step is a frame of the closed loop.

It is made by the same calls as any other (`simulators.environment`). A state says where the character is in the world,
and what its network is given next, before the next command: the trajectory, the gait and the joints in the frame of the
root (`episodes.layout.INPUT`, without the ground, which is flat), and the phase. The `info` of a step has

* `network`: the member that the frame is from, or that is weighted most; no such key if the phase decides,
* `stopped_by`: `flown_off` if the motion has left all bounds, so that the character stays where it was and `truncated`
  is true; else empty,
* `reward_source`, `end_source`: the name of the function that says reward and end, or `none`.

There is no `trust`: none is calibrated for motion. The `info` of a reset is empty.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box
from jaxtyping import Complex128, Float32, Float64, Int64

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.layout import FRAME_RATE, INPUT, INPUT_HEIGHTS
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec
from addressed_dynamics.networks.files import read_index
from addressed_dynamics.simulators.copies import Stepped
from addressed_dynamics.simulators.delivery import find_parts
from addressed_dynamics.simulators.motion import MotionModel
from addressed_dynamics.simulators.motion_controller import SLOWEST, Commands, Pose, State, inputs, reset
from addressed_dynamics.simulators.motion_loop import loop_frame, mean_pose
from addressed_dynamics.simulators.motion_predictor import MotionPredictor
from addressed_dynamics.simulators.rewards import LEARNED, NOBODY
from addressed_dynamics.simulators.spaces import checked_actions, checked_hold, observation_box, space_of_actions
from addressed_dynamics.simulators.tasks import Told, reward_and_end, sources, told

FASTEST = 3.0 * SLOWEST
"""Largest component of a velocity that can be asked for, in cm/frame: full stick, running."""
COMMANDS = ContinuousAction(
    (
        *(Dimension(f"velocity_{axis}", "cm/frame", -FASTEST, FASTEST) for axis in "xz"),
        *(Dimension(f"facing_{axis}", "", -1.0, 1.0) for axis in "xz"),
        Dimension("jog", "", 0.0, 1.0),
        Dimension("strafe", "", 0.0, 1.0),
        Dimension("crouch", "", 0.0, 1.0),
    )
)
"""What is asked of a character in a frame, in the world: to go somewhere, to look somewhere (a direction of any length;
of none at all: where it was asked to look before), to jog rather than to walk (if above 0), to look there also while it
walks, and to crouch."""
OBSERVED = [column for column in range(INPUT.width) if not INPUT_HEIGHTS.start <= column < INPUT_HEIGHTS.stop]
_UNBOUNDED = (-math.inf, math.inf)
SPACES = SpaceSpec(
    observation=(
        *(Dimension(f"root_{axis}", "cm", *_UNBOUNDED) for axis in "xz"),
        *(Dimension(f"facing_{axis}", "", *_UNBOUNDED) for axis in "xz"),
        *(
            Dimension(
                INPUT.names[column].replace(".", "_").replace("+", "plus_").replace("-", "minus_"),
                INPUT.units[column],
                *_UNBOUNDED,
            )
            for column in OBSERVED
        ),
        Dimension("phase_cosine", "", *_UNBOUNDED),
        Dimension("phase_sine", "", *_UNBOUNDED),
    ),
    action=COMMANDS,
    step_seconds=1 / FRAME_RATE,
)
"""Names and units of states and commands."""
ONLY_FOR_STATES = ("starts", "begin", "exogenous", "trust", "least_trust", "exact", "device")
"""Options of other environments, which say nothing of motion."""


def is_motion(model: Any, candidate: str | None) -> bool:
    """Return whether a model, or what a folder holds, is one of motion.

    Raises:
        ModelError: there is no model there.
    """
    if not isinstance(model, (str, Path)):
        return isinstance(model, MotionModel)
    parts = find_parts(Path(model), candidate, None, None)
    features = read_index(parts.network, "config.json").get("features")
    return isinstance(features, dict) and features.get("kind") == "motion"


@dataclass(frozen=True)
class MotionWorld:
    """A learned environment of motion without a state."""

    model: MotionModel
    start: Pose
    """The pose in which episodes begin: the mean of training."""
    task: Told | None
    """Who says reward and end; None for nobody."""
    hold: int
    """For how many frames commands are held; so many are one step of the environment."""
    observation_space: Box
    action_space: Box

    @staticmethod
    def of(
        model: MotionModel | str | Path,
        *,
        candidate: str | None = None,
        mode: Any = None,
        reward: Callable[..., Any] | str | None = None,
        hold: int = 1,
        **others: Any,
    ) -> MotionWorld:
        """Make one of a model, or of its folder; what the others mean says `WorldOptions`.

        Raises:
            ModelError: there is no such model or function, an option says nothing of motion, or the mode draws members.
        """
        asked = [name for name, value in others.items() if value not in (None, False) or name not in ONLY_FOR_STATES]
        if asked:
            why = ": none is calibrated for it" if "trust" in asked[0] else ""
            message = f"an environment of motion has no option '{asked[0]}'{why}; leave it out"
            raise ModelError(message)
        if isinstance(model, MotionModel):
            if (candidate, mode) != (None, None):
                message = (
                    "candidate and mode choose among the models in a folder, but a model was given; leave them out"
                )
                raise ModelError(message)
            used = model
        else:
            used = MotionModel.load(model, candidate=candidate, mode=mode)
        if used.mode == "sample":
            message = "an environment of motion does not draw members; choose another mode than 'sample'"
            raise ModelError(message)
        if reward == LEARNED:
            message = "logs of motion have no reward, so none was learned; give a function"
            raise ModelError(message)
        action = space_of_actions(SPACES, None)
        assert isinstance(action, Box)
        task = None if reward is None or reward == NOBODY else told(reward, "reward")
        return MotionWorld(used, mean_pose(used.features), task, checked_hold(hold), observation_box(SPACES), action)

    def described(self) -> dict[str, Any]:
        """Return metadata of an environment: names, units and the length of a step, as `addressed_dynamics.envs`."""
        return {
            "render_modes": [],
            "render_fps": FRAME_RATE / self.hold,
            "addressed_dynamics": {
                "observation": tuple((each.name, each.unit) for each in SPACES.observation),
                "action": tuple((each.name, each.unit) for each in COMMANDS.dimensions),
                "step_seconds": SPACES.step_seconds * self.hold,
            },
        }


def given_facings(options: Mapping[str, Any], number: int) -> Float64[np.ndarray, " copy"] | None:
    """Return where characters look at first, in rad from z towards x, that options of `reset` give; None if none.

    Raises:
        ModelError: an option is unknown, or not a finite number, or one for each copy.
    """
    if unknown := [str(key) for key in options if key != "facing"]:
        message = f"reset knows no option '{unknown[0]}' of motion (options: facing)"
        raise ModelError(message)
    if "facing" not in options:
        return None
    try:
        facing = np.asarray(options["facing"], np.float64)
    except (TypeError, ValueError):
        facing = np.array(math.nan)
    if facing.shape not in ((), (number,)) or not np.isfinite(facing).all():
        message = f"option 'facing' should be an angle in rad, or {number}, one for each copy"
        raise ModelError(message)
    return np.array(np.broadcast_to(facing, number))


class MotionCopies:
    """Copies of one world of motion, with the interface of `simulators.copies.Copies`."""

    def __init__(self, world: MotionWorld, number: int, limit: int | None = None) -> None:
        """Make copies that have not started; their episodes are truncated after `limit` steps, if there is one."""
        self.world = world
        self.generators: list[np.random.Generator] = []
        self.ended = np.ones(number, bool)
        self.steps = np.zeros(number, np.int64)
        self._limit = np.inf if limit is None else limit
        self._facing: Complex128[np.ndarray, " copy"] = np.ones(number, np.complex128)
        self._state = reset(world.start, self._facing)
        self._predictors: dict[str, MotionPredictor] = {"model": world.model.predictor()}

    def start(
        self, rows: Int64[np.ndarray, " chosen"], given: Float64[np.ndarray, " copy"] | None = None
    ) -> tuple[Float32[np.ndarray, "chosen observation"], dict[str, np.ndarray]]:
        """Let some of the characters stand at the origin in the mean pose, looking somewhere: given, or drawn."""
        if given is None:
            angle = np.array([self.generators[row].uniform(-math.pi, math.pi) for row in rows])
        else:
            angle = given[rows]
        self._facing[rows] = np.exp(1j * angle)
        self._put(rows, reset(self.world.start, self._facing[rows]))
        self.steps[rows], self.ended[rows] = 0, False
        return observed(self._rows(rows)), {}

    @torch.no_grad()
    def step(self, actions: Any, rows: Int64[np.ndarray, " chosen"]) -> Stepped:
        """Advance some of the characters by a frame.

        Raises:
            ModelError: a command is outside the space, a copy has ended, or a function of the user's fails.
        """
        world, state = self.world, self._rows(rows)
        chosen = checked_actions(SPACES, world.action_space, actions, len(rows))
        if self.ended[rows].any():
            message = f"copy {rows[self.ended[rows]][0]} has not started, or its episode has ended; reset it first"
            raise ModelError(message)
        seen = loop_frame(self._predictors, state, self._commands(chosen, rows), np.ones(len(rows), np.bool_))
        before, after = observed(state), observed(seen.after)
        nothing = np.empty((len(rows), 0), np.float32)
        reward, terminated = reward_and_end(world.task, before, chosen, after, nothing)
        self._put(rows, seen.after)
        self.steps[rows] += 1
        stopped = np.where(seen.alive, "", "flown_off").astype(object)
        truncated = ~seen.alive | (self.steps[rows] >= self._limit)
        self.ended[rows] = terminated | truncated
        info: dict[str, np.ndarray] = {"stopped_by": stopped}
        if world.model.mode != "phase":
            x = torch.from_numpy(np.where(seen.alive[:, None], seen.x, 0.0)).float()
            info = {"network": world.model.address(x).numpy(), **info}
        said_by = zip(("reward_source", "end_source"), sources(world.task), strict=True)
        info |= {name: np.full(len(rows), source, object) for name, source in said_by}
        return Stepped(after, reward, terminated, truncated, info)

    def _commands(self, chosen: Float32[np.ndarray, "chosen 7"], rows: Int64[np.ndarray, " chosen"]) -> Commands:
        velocity_x, velocity_z, facing_x, facing_z, jog, strafe, crouch = chosen.astype(np.float64).T
        asked = facing_z + 1j * facing_x
        length = np.abs(asked)
        self._facing[rows] = np.where(length > 0, asked / np.maximum(length, 1e-300), self._facing[rows])
        return Commands(velocity_z + 1j * velocity_x, self._facing[rows].copy(), jog > 0.0, strafe, crouch)

    def _rows(self, rows: Int64[np.ndarray, " chosen"]) -> State:
        return State(**{each.name: getattr(self._state, each.name)[rows] for each in fields(State)})

    def _put(self, rows: Int64[np.ndarray, " chosen"], state: State) -> None:
        for each in fields(State):
            getattr(self._state, each.name)[rows] = getattr(state, each.name)


def observed(state: State) -> Float32[np.ndarray, "copy observation"]:
    """Return states as an environment shows them."""
    turn = np.exp(2j * np.pi * state.phase)
    place = (state.root.imag, state.root.real, state.heading.imag, state.heading.real)
    columns = [*(each[:, None] for each in place), inputs(state)[:, OBSERVED], turn.real[:, None], turn.imag[:, None]]
    return np.concatenate(columns, axis=1).astype(np.float32)
