"""Where the feet stand, and how they swing from one foothold to the next."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.recording.walker.course import Course, stance_share
from addressed_dynamics.recording.walker.curves import Curve, Turns, Vectors, about_x, about_y, through
from addressed_dynamics.recording.walker.script import Style

TOE_HEIGHT = 2.7
"""Height of the toe joint while the foot stands, in cm."""
_HEEL_TO_TOE = 17.0
_WIDTH, _AHEAD, _TOE_OUT = 8.5, 8.0, 0.13
_NEAR = 4.0
"""A foot stays where it is if the next foothold is nearer than this, in cm."""
_CM_PER_RAD = 25.0
"""By how much a turn of the foot counts as a way."""

# Over the clock of a foot: it strikes at 0, leaves the ground at 0.5 and strikes again at 1. Pitch in degrees, heel
# up; negative is toe up. Lift of the toe joint in cm.
_CLOCK = np.array([0.0, 0.1, 0.24, 0.5, 0.6, 0.8, 0.94, 1.0])
_WALK_PITCH = np.array([-18.0, 0.0, 0.0, 46.0, 54.0, 2.0, -18.0, -18.0])
_JOG_PITCH = np.array([-4.0, 0.0, 0.0, 56.0, 82.0, 12.0, -6.0, -4.0])
_LIFT_CLOCK = np.array([0.0, 0.5, 0.66, 0.84, 1.0])
_WALK_LIFT = np.array([0.0, 0.0, 4.0, 1.5, 0.0])
_JOG_LIFT = np.array([0.0, 0.0, 13.0, 7.0, 0.0])


@dataclass(frozen=True)
class Foot:
    """One foot over time."""

    toe: Vectors
    """Where the toe joint is, in cm."""
    turns: Turns
    """How the foot is turned."""
    heading: Curve
    """Where it points, in rad."""
    pitch: Curve
    """How far the heel is above the ball of the foot, in rad."""


def swing(course: Course, side: int, style: Style) -> Foot:
    """Return how a foot moves; `side` is 1 for the left one and -1 for the right one."""
    time = np.arange(len(course.phase), dtype=np.float64)
    shift = 0.5 if side > 0 else 0.0
    strikes = np.arange(np.ceil(course.phase[0] - shift), np.floor(course.phase[-1] - shift)) + shift
    begin = np.interp(strikes, course.phase, time)
    share = np.interp(begin, time, stance_share(course.speed, course.running))
    end = np.interp(strikes + share, course.phase, time)
    toes, headings, ways = _footholds(course, side, style, time, (begin + end) / 2)
    events = np.stack([begin, end], axis=1).reshape(-1)[:-1]
    clock = through(time, events, np.arange(len(events)) / 2)
    stride = np.minimum(clock.astype(np.intp), len(strikes) - 2)
    within = clock - stride
    return _between(course, style, within, stride, toes, headings, ways)


def _footholds(
    course: Course, side: int, style: Style, time: Curve, middle: Float64[np.ndarray, " strike"]
) -> tuple[Float64[np.ndarray, "strike 2"], Float64[np.ndarray, " strike"], Float64[np.ndarray, " strike"]]:
    """Return where the toes stand, where the foot points, and how far each foothold is from the one before."""
    x, z, heading, running = (
        np.interp(middle, time, values) for values in (*course.place.T, course.heading, course.running)
    )
    across = side * _WIDTH * style.width * (1 - 0.45 * running)
    left, ahead = np.array([np.cos(heading), -np.sin(heading)]), np.array([np.sin(heading), np.cos(heading)])
    toes = (np.stack([x, z]) + across * left + _AHEAD * ahead).T
    headings = heading + side * _TOE_OUT * (1 - 0.6 * running)
    ways = np.zeros(len(toes))
    for strike in range(1, len(toes)):
        before = strike - 1
        way = np.hypot(*(toes[strike] - toes[before])) + _CM_PER_RAD * abs(headings[strike] - headings[before])
        if way < _NEAR:
            toes[strike], headings[strike] = toes[before], headings[before]
        else:
            ways[strike] = way
    return toes, headings, ways


def _between(
    course: Course,
    style: Style,
    within: Curve,
    stride: np.ndarray,
    toes: Float64[np.ndarray, "strike 2"],
    headings: Float64[np.ndarray, " strike"],
    ways: Float64[np.ndarray, " strike"],
) -> Foot:
    """Return the foot at the time `within` each stride."""
    share = np.clip(2 * within - 1, 0.0, 1.0)
    share = share**2 * (3 - 2 * share)
    # A foot that is set down belongs to the step before, a foot that stands flat or rises to the next one.
    size = np.sqrt(np.minimum(1.0, ways / 45))[np.where(within < 0.2, stride, stride + 1)]
    pitch_walk, pitch_jog = (np.radians(through(within, _CLOCK, pitch)) for pitch in (_WALK_PITCH, _JOG_PITCH))
    lift_walk, lift_jog = (through(within, _LIFT_CLOCK, lift) for lift in (_WALK_LIFT, _JOG_LIFT))
    # Running changes slowly, but a foot that stands must not feel it: flat is flat in both.
    pitch = size * (pitch_walk + course.running * (pitch_jog - pitch_walk))
    lift = size * style.lift * (lift_walk + course.running * (lift_jog - lift_walk))
    flat = toes[stride] + share[:, None] * (toes[stride + 1] - toes[stride])
    heading = headings[stride] + share * (headings[stride + 1] - headings[stride])
    height = TOE_HEIGHT + lift + _HEEL_TO_TOE * np.sin(np.maximum(-pitch, 0.0))
    toe = np.stack([flat[:, 0], height, flat[:, 1]], axis=1)
    return Foot(toe, about_y(heading) @ about_x(pitch), heading, pitch)
