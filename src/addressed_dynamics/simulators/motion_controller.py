"""The controller of Holden, Komura and Saito (SIGGRAPH 2017): from commands to inputs, from outputs to motion.

It keeps a trajectory of the root, one entry a frame: 60 frames of the past, the present, and a future that blends what
the network predicted with what the player asks for. Several runs advance side by side. All functions return new states.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Complex128, Float32, Float64

from addressed_dynamics.episodes.layout import FUTURE_OFFSETS, GAITS, INPUT, INPUT_GAITS, OFFSETS, OUTPUT
from addressed_dynamics.simulators.motion_ground import JOINT_X, JOINT_Y, JOINT_Z, ground, ground_of

NOW = -OFFSETS[0]
"""Index of the present in a trajectory, which begins this many frames before it."""
FUTURE = OFFSETS[-1]
"""Frames of the future. The published controller keeps nine more, but no input samples them."""
SPAN = 60
"""Frames after which the future would be as commanded."""
STEP = OFFSETS[1] - OFFSETS[0]
"""Frames between two samples of a trajectory."""
COMMAND_SHARE, GAIT_SHARE, JOINT_SHARE = 0.9, 0.1, 0.5
"""How far targets, gaits and joint positions move in a frame towards the command or the prediction."""
STANDING_SPEED = 0.1
"""Below this target speed, in cm/frame, the gait is to stand."""
SLOWEST = 2.5
"""Speed at full stick and without running, in cm/frame; running adds up to twice as much."""
STILL_SPEED = 1e-5
"""Below this target speed, in cm/frame, the character looks along the facing and not where it goes."""

_REMAINING = 1.0 - np.arange(1, FUTURE + 1) / SPAN


@dataclass(frozen=True)
class Pose:
    """Joints of a character, in the frame of its root."""

    position: Float64[np.ndarray, "31 3"]
    """In cm."""
    velocity: Float64[np.ndarray, "31 3"]
    """In cm/frame."""


@dataclass(frozen=True)
class Commands:
    """What is asked of each run in one frame; `commands.Script` says what the fields mean."""

    velocity: Complex128[np.ndarray, " run"]
    facing: Complex128[np.ndarray, " run"]
    jogging: Bool[np.ndarray, " run"]
    strafe: Float64[np.ndarray, " run"]
    crouch: Float64[np.ndarray, " run"]


@dataclass(frozen=True)
class State:
    """Where each run is. The ground is flat, so that it takes complex numbers (`simulators.motion_ground`)."""

    position: Complex128[np.ndarray, "run 111"]
    """Trajectory of the root in the world, in cm."""
    direction: Complex128[np.ndarray, "run 111"]
    """Where it faces in the world."""
    gait: Float64[np.ndarray, "run gait 61"]
    """Gaits, up to the present; the future is like the present."""
    target_velocity: Complex128[np.ndarray, " run"]
    """Smoothed command, in cm/frame."""
    target_direction: Complex128[np.ndarray, " run"]
    phase: Float64[np.ndarray, " run"]
    """Phase of the gait cycle, in [0, 1)."""
    joint_ground: Complex128[np.ndarray, "run 31"]
    """Joints seen from above, in the world, in cm."""
    joint_height: Float64[np.ndarray, "run 31"]
    joint_velocity_ground: Complex128[np.ndarray, "run 31"]
    """In cm/frame."""
    joint_velocity_height: Float64[np.ndarray, "run 31"]

    @property
    def root(self) -> Complex128[np.ndarray, " run"]:
        """Where the root is."""
        return self.position[:, NOW]

    @property
    def heading(self) -> Complex128[np.ndarray, " run"]:
        """Where it faces."""
        return self.direction[:, NOW]


def reset(pose: Pose, facing: Complex128[np.ndarray, " run"]) -> State:
    """Return runs that stand at the origin in `pose`: no gait, no past, phase 0."""
    runs, turn = len(facing), facing[:, None]
    entries = (runs, NOW + 1 + FUTURE)
    return State(
        position=np.zeros(entries, np.complex128),
        direction=np.broadcast_to(turn, entries).copy(),
        gait=np.zeros((runs, len(GAITS), NOW + 1)),
        target_velocity=np.zeros(runs, np.complex128),
        target_direction=facing.copy(),
        phase=np.zeros(runs),
        joint_ground=turn * ground_of(pose.position),
        joint_height=np.repeat(pose.position[None, :, 1], runs, axis=0),
        joint_velocity_ground=turn * ground_of(pose.velocity),
        joint_velocity_height=np.repeat(pose.velocity[None, :, 1], runs, axis=0),
    )


def follow(state: State, commands: Commands) -> State:
    """Return the state with targets, gait and future trajectory moved towards the commands."""
    velocity = state.target_velocity + COMMAND_SHARE * (commands.velocity - state.target_velocity)
    speed = np.abs(velocity)
    ahead = np.where(speed < STILL_SPEED, commands.facing, velocity / np.maximum(speed, STILL_SPEED))
    direction = slerp(state.target_direction, slerp(ahead, commands.facing, commands.strafe), COMMAND_SHARE)

    strafe = commands.strafe[:, None]
    position_share = 1.0 - _REMAINING ** (0.5 + 0.5 * strafe)
    direction_share = 1.0 - _REMAINING ** (2.0 - 1.5 * strafe)
    steps = np.diff(state.position[:, NOW:], axis=1)
    steps += position_share * (velocity[:, None] - steps)
    position, directions = state.position.copy(), state.direction.copy()
    position[:, NOW + 1 :] = state.root[:, None] + np.cumsum(steps, axis=1)
    directions[:, NOW + 1 :] = slerp(directions[:, NOW + 1 :], direction[:, None], direction_share)

    gait = state.gait.copy()
    gait[:, :, NOW] += GAIT_SHARE * (_target_gait(speed, commands) - gait[:, :, NOW])
    return _with(
        state,
        position=position,
        direction=directions,
        gait=gait,
        target_velocity=velocity,
        target_direction=direction,
    )


def inputs(state: State) -> Float64[np.ndarray, "run 342"]:
    """Return what a network is given: the trajectory in the present root, the joints in the root before it."""
    x = np.zeros((len(state.phase), INPUT.width))
    back = state.heading.conj()[:, None]
    trajectory = (state.position[:, ::STEP] - state.root[:, None]) * back
    x[:, INPUT.trajectory_position_x], x[:, INPUT.trajectory_position_z] = trajectory.imag, trajectory.real
    direction = state.direction[:, ::STEP] * back
    x[:, INPUT.trajectory_direction_x], x[:, INPUT.trajectory_direction_z] = direction.imag, direction.real
    gaits = x[:, INPUT_GAITS].reshape(len(x), len(GAITS), len(OFFSETS))
    gaits[:, :, : NOW // STEP] = state.gait[:, :, :NOW:STEP]
    gaits[:, :, NOW // STEP :] = state.gait[:, :, NOW:]
    back = state.direction[:, NOW - 1, None].conj()
    joints = (state.joint_ground - state.position[:, NOW - 1, None]) * back
    _set_joints(x[:, INPUT.joint_position], joints, state.joint_height)
    _set_joints(x[:, INPUT.joint_velocity], state.joint_velocity_ground * back, state.joint_velocity_height)
    return x


def pose(state: State, y: Float64[np.ndarray, "run 311"]) -> State:
    """Return the state with the joints that were predicted, half-way from where their velocities lead."""
    turn = state.heading[:, None]
    position, velocity = y[:, OUTPUT.joint_position], y[:, OUTPUT.joint_velocity]
    velocity_ground = turn * ground(velocity[:, JOINT_X], velocity[:, JOINT_Z])
    velocity_height = velocity[:, JOINT_Y].copy()
    predicted = state.root[:, None] + turn * ground(position[:, JOINT_X], position[:, JOINT_Z])
    moved, raised = state.joint_ground + velocity_ground, state.joint_height + velocity_height
    return _with(
        state,
        joint_ground=moved + JOINT_SHARE * (predicted - moved),
        joint_height=raised + JOINT_SHARE * (position[:, JOINT_Y] - raised),
        joint_velocity_ground=velocity_ground,
        joint_velocity_height=velocity_height,
    )


def advance(state: State, y: Float64[np.ndarray, "run 311"]) -> State:
    """Return the state one frame later: the root moved, the past shifted, the future as predicted, the phase on.

    A standing character moves and turns less: by (1 - stand)^0.25 of what was predicted.
    """
    moving = np.maximum(1.0 - state.gait[:, GAITS.index("stand"), NOW], 0.0) ** 0.25
    step = y[:, OUTPUT.root_velocity]
    root = state.root + moving * state.heading * ground(step[:, 0], step[:, 1])
    heading = state.heading * np.exp(-1j * moving * y[:, OUTPUT.root_turn][:, 0])
    heading /= np.abs(heading)
    future = ground(y[:, OUTPUT.trajectory_position_x], y[:, OUTPUT.trajectory_position_z]) @ _BETWEEN
    direction = ground(y[:, OUTPUT.trajectory_direction_x], y[:, OUTPUT.trajectory_direction_z]) @ _BETWEEN
    direction /= np.maximum(np.abs(direction), 1e-8)
    past, now = slice(1, NOW + 1), (root[:, None], heading[:, None])
    change = y[:, OUTPUT.phase_change][:, 0]
    return _with(
        state,
        position=np.concatenate([state.position[:, past], now[0], now[0] + now[1] * future], axis=1),
        direction=np.concatenate([state.direction[:, past], now[1], now[1] * direction], axis=1),
        gait=np.concatenate([state.gait[:, :, past], state.gait[:, :, NOW:]], axis=2),
        phase=(state.phase + (0.9 * moving + 0.1) * change) % 1.0,
    )


def keep(old: State, new: State, moving: Bool[np.ndarray, " run"]) -> State:
    """Return `new` for the runs that are `moving`, and `old` for the others."""
    pairs = ((field.name, getattr(old, field.name), getattr(new, field.name)) for field in fields(State))
    return State(
        **{name: np.where(moving.reshape(-1, *[1] * (was.ndim - 1)), becomes, was) for name, was, becomes in pairs}
    )


def joints_in_world(state: State) -> Float32[np.ndarray, "run 31 3"]:
    """Return the joints x, y, z, in cm."""
    joints = (state.joint_ground.imag, state.joint_height, state.joint_ground.real)
    return np.stack(joints, axis=-1).astype(np.float32)


def slerp(
    start: Complex128[np.ndarray, "*any"],
    end: Complex128[np.ndarray, "*any"],
    share: Float64[np.ndarray, "*any"] | float,
) -> Complex128[np.ndarray, "*any"]:
    """Return headings turned from `start` towards `end`, the shorter way, by a share of the angle between them."""
    turned: Complex128[np.ndarray, "*any"] = start * np.exp(1j * share * np.angle(end * start.conj()))
    return turned


def _target_gait(speed: Float64[np.ndarray, " run"], commands: Commands) -> Float64[np.ndarray, "run gait"]:
    standing = speed < STANDING_SPEED
    crouching = ~standing & (commands.crouch > 0.1)
    jogging = ~standing & ~crouching & commands.jogging
    target = np.zeros((len(speed), len(GAITS)))
    target[:, GAITS.index("stand")] = standing
    target[:, GAITS.index("crouch")] = crouching * commands.crouch
    target[:, GAITS.index("jog")] = jogging
    target[:, GAITS.index("walk")] = ~(standing | crouching | jogging)
    return target


def _set_joints(
    columns: Float64[np.ndarray, "run 93"],
    seen_from_above: Complex128[np.ndarray, "run 31"],
    height: Float64[np.ndarray, "run 31"],
) -> None:
    columns[:, JOINT_X], columns[:, JOINT_Y], columns[:, JOINT_Z] = seen_from_above.imag, height, seen_from_above.real


def _between_samples() -> Complex128[np.ndarray, "6 50"]:
    """Return the weights that interpolate a predicted trajectory linearly, frame by frame."""
    frames = np.arange(1, FUTURE + 1)
    weights = np.stack([np.interp(frames, FUTURE_OFFSETS, row) for row in np.eye(len(FUTURE_OFFSETS))])
    return weights.astype(np.complex128)


def _with(state: State, **changes: np.ndarray) -> State:
    values = {field: getattr(state, field) for field in _FIELDS}
    return State(**(values | changes))


_FIELDS = tuple(field.name for field in fields(State))
_BETWEEN = _between_samples()
