"""Scripts of commands: what a player asks of the character in each frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from jaxtyping import Complex128, Float64, Int64

from addressed_dynamics.base.errors import EvaluationError
from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.simulators.motion_controller import SLOWEST

Kind = Literal["stand", "walk", "walk_turn", "jog", "jog_turn"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""What a segment asks for, by which the results are grouped."""


@dataclass(frozen=True)
class Segment:
    """A stretch of time in which one thing is asked for."""

    seconds: float
    stick: float = 0.0
    """How far the stick is pushed, in [0, 1]."""
    run: float = -1.0
    """How much to run, in [-1, 1]; -1 is to walk."""
    turn: float = 0.0
    """Rate at which the stick and the facing turn, in degrees/s; to the left is positive."""
    strafe: float = 0.0
    """How much to look along the facing instead of the way one goes, in [0, 1]."""
    crouch: float = 0.0
    """How much to crouch, in [0, 1]."""

    @property
    def kind(self) -> Kind:
        """What it asks for."""
        if not self.stick:
            return "stand"
        if self.run > -1.0:
            return "jog_turn" if self.turn else "jog"
        return "walk_turn" if self.turn else "walk"


@dataclass(frozen=True)
class Script:
    """Commands, one a frame at 60 Hz."""

    segments: tuple[Segment, ...]
    """What they are made of."""
    segment: Int64[np.ndarray, " frame"]
    """Which segment a frame belongs to."""
    stick: Complex128[np.ndarray, " frame"]
    """Where the stick points in the world (`simulators.motion_ground`), at most 1 long."""
    facing: Complex128[np.ndarray, " frame"]
    """Where to look when standing or strafing: a heading in the world, 1 long."""
    run: Float64[np.ndarray, " frame"]
    strafe: Float64[np.ndarray, " frame"]
    crouch: Float64[np.ndarray, " frame"]

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.segment)

    @property
    def velocity(self) -> Complex128[np.ndarray, " frame"]:
        """Velocity asked for, in cm/frame."""
        velocity: Complex128[np.ndarray, " frame"] = SLOWEST * (2.0 + self.run) * self.stick
        return velocity

    def rotated(self, angle: float) -> Script:
        """Return the same commands for a world turned by `angle` radians."""
        turn = np.exp(1j * angle)
        return Script(
            self.segments, self.segment, self.stick * turn, self.facing * turn, self.run, self.strafe, self.crouch
        )


def script(segments: Sequence[Segment], *, heading: float = 0.0) -> Script:
    """Return the commands of `segments`, one after the other, beginning with a heading in radians.

    Raises:
        EvaluationError: a segment is shorter than a frame.
    """
    lengths = [round(segment.seconds * FRAME_RATE) for segment in segments]
    if not lengths or min(lengths) < 1:
        message = "a script of commands needs segments of at least one frame (1/60 s) each"
        raise EvaluationError(message)
    index = np.repeat(np.arange(len(segments)), lengths)

    def of(name: str) -> Float64[np.ndarray, " frame"]:
        values: Float64[np.ndarray, " frame"] = np.array([getattr(each, name) for each in segments], np.float64)[index]
        return values

    # Left is towards +x, and the heading is the angle from z to x: turning left raises it.
    facing = np.exp(1j * (heading + np.cumsum(np.radians(of("turn")) / FRAME_RATE)))
    return Script(tuple(segments), index, of("stick") * facing, facing, of("run"), of("strafe"), of("crouch"))


def standard_script() -> Script:
    """Return the 60 s on which models are judged: stand, walk, turn both ways, jog, turn both ways, stop, walk."""
    walk, jog = {"stick": 1.0}, {"stick": 1.0, "run": -0.5}
    return script(
        [
            Segment(3.0),
            Segment(8.0, **walk),
            Segment(4.0, **walk, turn=45.0),
            Segment(4.0, **walk),
            Segment(4.0, **walk, turn=-45.0),
            Segment(4.0, **walk),
            Segment(3.0),
            Segment(3.0, **walk),
            Segment(8.0, **jog),
            Segment(3.0, **jog, turn=60.0),
            Segment(4.0, **jog),
            Segment(3.0, **jog, turn=-60.0),
            Segment(4.0, **walk),
            Segment(5.0),
        ]
    )


def random_script(generator: np.random.Generator, seconds: float = 20.0) -> Script:
    """Return commands drawn at random: for choosing between models without looking at the test script.

    It begins with a second of standing; then, for 2 to 5 s each, it stands (1 in 8), walks (as often as it jogs),
    straight on or turning by 20 to 75 degrees/s to either side.
    """
    segments, left = [Segment(1.0)], seconds - 1.0
    while left > 0.0:
        length = min(left, float(generator.uniform(2.0, 5.0)))
        # A rest that is too short for a segment of its own goes to this one.
        length = left if left - length < 2.0 else length
        segments.append(_random_segment(generator, length))
        left -= length
    return _cut(segments, round(seconds * FRAME_RATE), float(generator.uniform(-math.pi, math.pi)))


def validation_scripts(seed: int, number: int = 3, seconds: float = 20.0) -> tuple[Script, ...]:
    """Return `number` random scripts of the same length; the same seed gives the same scripts."""
    generator = np.random.default_rng(seed)
    return tuple(random_script(generator, seconds) for _ in range(number))


def _random_segment(generator: np.random.Generator, seconds: float) -> Segment:
    if generator.random() < 1 / 8:
        return Segment(seconds)
    run = float(generator.uniform(-0.8, -0.2)) if generator.random() < 0.5 else -1.0
    turn = float(generator.uniform(20.0, 75.0) * generator.choice([-1.0, 1.0])) if generator.random() < 0.5 else 0.0
    return Segment(seconds, stick=float(generator.uniform(0.7, 1.0)), run=run, turn=turn)


def _cut(segments: list[Segment], frames: int, heading: float) -> Script:
    """Return the commands of `segments` in exactly `frames` frames: rounding each can give one more or less."""
    *first, last = segments
    before = sum(round(segment.seconds * FRAME_RATE) for segment in first)
    seconds = (frames - before) / FRAME_RATE
    return script([*first, Segment(seconds, last.stick, last.run, last.turn)], heading=heading)
