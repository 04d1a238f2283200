"""A body carried by its feet: hips, legs by inverse kinematics, trunk, head and arms."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.episodes.layout import JOINTS
from addressed_dynamics.recording.walker.body import OFFSETS, SHIN, STANDING, THIGH
from addressed_dynamics.recording.walker.course import Course
from addressed_dynamics.recording.walker.curves import (
    RATE,
    Curve,
    Turns,
    Vectors,
    about_x,
    about_y,
    about_z,
    drift,
    lowest_around,
    smooth,
)
from addressed_dynamics.recording.walker.feet import Foot
from addressed_dynamics.recording.walker.script import Style

_LONGEST = 0.992 * (THIGH + SHIN)
"""Farthest that an ankle gets from its hip, in cm: a straight knee would turn over at once."""
_GRAVITY = 981.0
Joints = Float64[np.ndarray, "frame 31 3 3"]
"""How each joint is turned against its parent."""
_SIDES = {"Left": 1, "Right": -1}


def pose(course: Course, feet: dict[str, Foot], style: Style, generator: np.random.Generator) -> tuple[Vectors, Joints]:
    """Return where the hips are, in cm, and how each joint is turned against its parent.

    Args:
        course: where to go.
        feet: where each foot is, by `Left` and `Right`.
        style: how to carry oneself.
        generator: source of what never repeats exactly.
    """
    frames = len(course.phase)
    local = np.tile(np.eye(3), (frames, len(JOINTS), 1, 1))
    lean, bend = _carriage(course, style, generator)
    yaw = np.radians(4.0 + 2.0 * course.running) * style.twist * course.moving * np.cos(2 * np.pi * course.phase)
    roll = 0.5 * bend - np.radians(1.5 + 1.3 * course.moving) * _weight(course)
    local[:, JOINTS.index("Hips")] = about_y(course.heading + yaw) @ about_x(0.4 * lean) @ about_z(roll)
    ankles = {side: foot.toe - foot.turns @ OFFSETS[JOINTS.index(f"{side}ToeBase")] for side, foot in feet.items()}
    place = _hips_place(course, local[:, JOINTS.index("Hips")], ankles, style, generator)
    for side, foot in feet.items():
        _set_leg(local, side, place, ankles[side], foot, course.heading + yaw)
    _set_trunk(local, course, lean, bend, (yaw, 0.4 * lean, roll), generator)
    for side in _SIDES:
        _set_arm(local, side, course, style, generator)
    return place, local


def _weight(course: Course) -> Curve:
    """Return 1 while the weight is on the right foot, -1 while it is on the left one, as a smooth curve."""
    weight: Curve = np.cos(2 * np.pi * (course.phase - 0.29))
    return weight


def _carriage(course: Course, style: Style, generator: np.random.Generator) -> tuple[Curve, Curve]:
    """Return how far the trunk leans forward and how far it is tilted into a bend, in rad."""
    faster = np.gradient(smooth(course.speed, 0.1)) * RATE
    lean = style.lean * np.radians(2.5 + course.moving + 5.5 * course.running)
    lean += 0.35 * np.arctan(faster / _GRAVITY) + np.radians(0.8) * drift(len(lean), 0.8, generator)
    return lean, -0.6 * np.arctan(course.speed * course.turn / _GRAVITY)


def _hips_place(
    course: Course, turned: Turns, ankles: dict[str, Vectors], style: Style, generator: np.random.Generator
) -> Vectors:
    """Return where the hips are: from side to side over the foot that carries them, and no higher than legs reach."""
    clock = 4 * np.pi * course.phase
    pace = np.minimum(1.0, course.speed / 120)
    still = 2.2 + 0.5 * drift(len(clock), 1.0, generator)
    sway = still + course.moving * (style.sway * (2.6 - 1.3 * course.running) - still)
    right = np.stack([-np.cos(course.heading), np.sin(course.heading)], axis=1)
    x, z = (course.place + (sway * _weight(course))[:, None] * right).T
    walk = 1.7 * np.cos(clock - 4 * np.pi * 0.29) - 1.3
    jog = -3.6 * np.cos(clock - 4 * np.pi * 0.17) - 4.5
    height = STANDING + style.bob * course.moving * pace * (walk + course.running * (jog - walk))
    for side, ankle in ankles.items():
        hip = turned @ OFFSETS[JOINTS.index(f"{side}UpLeg")]
        away = (x + hip[:, 0] - ankle[:, 0]) ** 2 + (z + hip[:, 2] - ankle[:, 2]) ** 2
        height = np.minimum(height, ankle[:, 1] - hip[:, 1] + np.sqrt(np.maximum(_LONGEST**2 - away, 400.0)))
    # A mean over frames of what is lowest around each of them is nowhere above the lowest.
    reach = round(0.1 * RATE)
    return np.stack([x, smooth(lowest_around(height, reach), 0.1 / 3), z], axis=1)


def _set_leg(local: Joints, side: str, place: Vectors, ankle: Vectors, foot: Foot, facing: Curve) -> None:
    """Turn a leg so that it ends at `ankle`, with the knee in front, between where hips and foot point."""
    hips = local[:, JOINTS.index("Hips")]
    down = ankle - place - hips @ OFFSETS[JOINTS.index(f"{side}UpLeg")]
    length = np.linalg.norm(down, axis=1, keepdims=True)
    down = down / length
    length = np.minimum(length, THIGH + SHIN - 0.01)
    along = (length**2 + THIGH**2 - SHIN**2) / (2 * length)
    middle = (facing + foot.heading) / 2
    # The hinge of the knee points to the left.
    hinge = np.stack([np.cos(middle), np.zeros_like(middle), -np.sin(middle)], axis=1)
    hinge -= (hinge * down).sum(axis=1, keepdims=True) * down
    hinge /= np.linalg.norm(hinge, axis=1, keepdims=True)
    forward = np.cross(down, hinge)
    thigh = along * down + np.sqrt(np.maximum(THIGH**2 - along**2, 0.0)) * forward
    upper, lower = (_with_axes(hinge, -bone) for bone in (thigh, length * down - thigh))
    local[:, JOINTS.index(f"{side}UpLeg")] = _inverse(hips) @ upper
    local[:, JOINTS.index(f"{side}Leg")] = _inverse(upper) @ lower
    local[:, JOINTS.index(f"{side}Foot")] = _inverse(lower) @ foot.turns
    local[:, JOINTS.index(f"{side}ToeBase")] = about_x(-0.8 * np.maximum(foot.pitch, 0.0))


def _with_axes(x: Vectors, y: Vectors) -> Turns:
    """Return the turns that carry the x axis to `x` and the y axis along `y`, which is perpendicular to it."""
    y = y / np.linalg.norm(y, axis=1, keepdims=True)
    return np.stack([x, y, np.cross(x, y)], axis=2)


def _inverse(turns: Turns) -> Turns:
    return turns.transpose(0, 2, 1)


def _set_trunk(
    local: Joints,
    course: Course,
    lean: Curve,
    bend: Curve,
    hips: tuple[Curve, Curve, Curve],
    generator: np.random.Generator,
) -> None:
    """Turn back and neck: the shoulders against the hips, the head to where it goes."""
    yaw, pitch, roll = hips
    frames = len(lean)
    shoulders = -1.4 * yaw + np.radians(1.5) * drift(frames, 0.9, generator)
    back = about_y((shoulders - yaw) / 3) @ about_x((lean - pitch) / 3) @ about_z((bend - roll) / 3)
    gaze = 0.25 * course.turn + np.radians(5.0) * drift(frames, 0.8, generator)
    nod = np.radians(3.0) - 0.8 * lean + np.radians(2.0) * drift(frames, 0.6, generator)
    neck = about_y((gaze - shoulders) / 3) @ about_x(nod / 3) @ about_z(-0.6 * bend / 3)
    for joints, turns in ((("LowerBack", "Spine", "Spine1"), back), (("Neck", "Neck1", "Head"), neck)):
        for joint in joints:
            local[:, JOINTS.index(joint)] = turns


def _set_arm(local: Joints, side: str, course: Course, style: Style, generator: np.random.Generator) -> None:
    """Let an arm swing with the leg of the other side, the elbow the more bent the faster it goes."""
    sign, running = _SIDES[side], course.running
    frames = len(running)
    forward = sign * np.cos(2 * np.pi * (course.phase - 0.03))
    pace = course.moving * np.minimum(1.0, course.speed / 60)
    most = style.arms * np.radians(10 + 0.09 * course.speed + running * (12 - 0.05 * course.speed))
    most *= 1 + 0.12 * drift(frames, 0.8, generator)
    ahead = pace * most * forward + np.radians(2 - 10 * running + 2.0 * drift(frames, 0.9, generator))
    down = np.radians(80 - 8 * running + 1.5 * drift(frames, 0.9, generator))
    inward = np.radians(15 + 22 * running)
    walk, jog = 16 + 8 * pace * (1 + forward), 78 + 13 * forward
    elbow = style.elbows * np.radians(walk + running * (jog - walk))
    local[:, JOINTS.index(f"{side}Arm")] = about_x(-ahead) @ about_z(-sign * down) @ about_x(inward)
    local[:, JOINTS.index(f"{side}ForeArm")] = about_y(-sign * elbow)
    local[:, JOINTS.index(f"{side}Hand")] = about_y(np.full(frames, -sign * np.radians(8.0)))
