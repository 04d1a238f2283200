"""Where a walker goes: its path on the ground, its gaits, and the clock of its steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.recording.walker.curves import RATE, Curve, drift, lowest_around, smooth
from addressed_dynamics.recording.walker.script import GAITS, Command, Style

MARGIN = 5 * RATE
"""Frames before and after a clip: the first step and the last need a foothold outside of it."""
_RAMP = 84
"""Frames that the label of a gait takes to change, as in the published clips."""


@dataclass(frozen=True)
class Course:
    """A path and what is done along it, with the margins of the clip."""

    place: Float64[np.ndarray, "frame 2"]
    """Where the middle between the feet is meant to be, x and z in cm."""
    heading: Curve
    """Where it faces: from z towards x (to the left), in rad."""
    speed: Curve
    """How fast it goes, in cm/s."""
    turn: Curve
    """How fast it turns, in rad/s."""
    gaits: Float64[np.ndarray, "frame 8"]
    """Share of each of `GAITS`."""
    moving: Curve
    """1 while steps are taken, 0 while it stands."""
    running: Curve
    """1 while it jogs or runs, 0 while it walks."""
    phase: Curve
    """Strides since the beginning: the right foot strikes at whole numbers, the left one halfway between them."""


def follow(commands: list[Command], frames: int, style: Style, generator: np.random.Generator) -> Course:
    """Return the course that follows commands for `frames`, besides the margins, in which it goes on as it is."""
    lengths = [round(command.seconds * RATE) for command in commands]
    index = np.pad(np.repeat(np.arange(len(commands)), lengths)[:frames], MARGIN, mode="edge")
    total = len(index)
    gait = np.array([GAITS.index(command.gait) for command in commands])[index]
    wish = np.array([command.speed for command in commands])[index]
    speed = smooth(wish, 0.33) * (1 + 0.04 * drift(total, 0.7, generator))
    turn = smooth(np.array([command.turn for command in commands])[index], 0.25)
    turn += 0.08 * drift(total, 0.7, generator) * np.minimum(1.0, speed / 60)
    labels = np.eye(len(GAITS))[np.pad(gait, (_RAMP // 2, _RAMP - _RAMP // 2 - 1), mode="edge")]
    gaits = np.lib.stride_tricks.sliding_window_view(labels, _RAMP, axis=0).mean(axis=-1)
    running = smooth((gait == GAITS.index("jog")) + (gait == GAITS.index("run")) + 0.0, 0.2)
    moving = _moving(speed, turn)
    heading = generator.uniform(-np.pi, np.pi) + np.cumsum(turn) / RATE
    place = np.cumsum(speed[:, None] * np.stack([np.sin(heading), np.cos(heading)], axis=1), axis=0) / RATE
    phase = generator.uniform() + np.cumsum(_cadence(speed, running, moving) * (1 + (1 / style.stride - 1) * moving))
    return Course(place, heading, speed, turn, gaits, moving, running, phase)


def _moving(speed: Curve, turn: Curve) -> Curve:
    """Steps begin a little before the body moves, and go on until both feet stand where they should."""
    still = 1.0 - ((speed > 6) | (np.abs(turn) > 0.12))
    before, after = round(0.2 * RATE), round(1.2 * RATE)
    reach = (before + after) // 2
    moved = 1 - np.roll(lowest_around(still, reach), (after - before) // 2)
    return smooth(moved, 0.1)


def _cadence(speed: Curve, running: Curve, moving: Curve) -> Curve:
    """Return strides a frame. While it stands, the clock times how the weight goes from foot to foot."""
    walk = 0.64 + 0.0027 * speed
    jog = 1.2 + 0.0008 * speed
    strides: Curve = 0.55 + moving * (walk + running * (jog - walk) - 0.55)
    return strides / RATE


def stance_share(speed: Curve, running: Curve) -> Curve:
    """Return the share of a stride for which a foot stands."""
    walk = np.clip(0.68 - 0.0006 * speed, 0.56, 0.7)
    jog = np.clip(0.44 - 0.0003 * speed, 0.3, 0.42)
    share: Curve = walk + running * (jog - walk)
    return share
