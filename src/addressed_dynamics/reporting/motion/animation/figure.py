"""What a person looks like, and the ground under them."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float64
from PIL import ImageColor

from addressed_dynamics.episodes.layout import FRAME_RATE, JOINTS
from addressed_dynamics.reporting.common.animation.brush import Brush, Point
from addressed_dynamics.reporting.common.animation.camera import Camera
from addressed_dynamics.reporting.common.animation.scenes import SOFT
from addressed_dynamics.reporting.motion.actors import ARROW_FRAMES, ASKED, CONTACT_JOINTS, TOUCHED

_SHADOW = "#d4d4d4"
SHADES = (SOFT, _SHADOW)
"""Colours of what stands back."""

_TRACE_FRAMES = 2 * FRAME_RATE
_TILE, _STAGE = 80.0, 130.0  # side of a tile of the ground, and how far around a person there are some, in cm

_LIMBS = (
    ("UpLeg", "Leg", 9.5), ("Leg", "Foot", 8.0), ("Foot", "ToeBase", 6.5),
    ("Arm", "ForeArm", 7.0), ("ForeArm", "Hand", 6.0), ("Hand", "HandIndex1", 5.0),
)  # fmt: skip
"""Bones of a side of the body, and how thick they are, in cm."""
_TRUNK = [JOINTS.index(joint) for joint in ("LeftArm", "RightArm", "RightUpLeg", "LeftUpLeg")]
_HEAD, _NECK, _CHEST = (JOINTS.index(joint) for joint in ("Head", "Neck1", "Neck"))
_BONES = tuple(
    (JOINTS.index(side + start), JOINTS.index(side + end), width)
    for side in ("Left", "Right")
    for start, end, width in _LIMBS
)
"""Both ends of each bone of arms and legs, and how thick it is, in cm."""


def draw_ground(
    brush: Brush,
    camera: Camera,
    positions: Float[np.ndarray, "time 31 3"],
    touching: Bool[np.ndarray, "time 4"],
    command: Float[np.ndarray, 2] | None,
) -> None:
    """Draw what lies on the ground: its tiles, where feet stood lately, the way asked for, the shadow."""
    _draw_tiles(brush, camera)
    recent = positions[-_TRACE_FRAMES:, CONTACT_JOINTS]
    stood = recent[touching[-_TRACE_FRAMES:]] * [1, 0, 1]
    near = stood[np.linalg.norm(stood - camera.target * [1, 0, 1], axis=1) < _STAGE]
    for place in camera.seen(np.unique(near.round(), axis=0)):  # whole cm: a foot that stands is one place
        brush.disc(place, _mixed(TOUCHED, 0.5), 1.6)
    shadow = camera.seen(positions[-1].astype(np.float64) * [1, 0, 1])
    for start, end, width in _BONES:
        brush.line([shadow[start], shadow[end]], _SHADOW, 0.9 * width * camera.scale)
    if command is not None and np.hypot(*command) > 0.05:
        way = camera.target * [1, 0, 1] + np.linspace(0.12, 1.0, 2)[:, None] * ARROW_FRAMES * np.array(
            [command[0], 0.0, command[1]]
        )
        brush.arrow(camera.seen(way), ASKED, 4)


def _draw_tiles(brush: Brush, camera: Camera) -> None:
    """Draw every other tile of the ground, as far as they are on the stage, a disc around the target."""
    middle = camera.target[[0, 2]]
    first, last = np.floor((middle - _STAGE) / _TILE).astype(int), np.floor((middle + _STAGE) / _TILE).astype(int)
    outlines = []
    for column in range(first[0], last[0] + 1):
        left, right = np.clip(np.array([column, column + 1]) * _TILE - middle[0], -_STAGE, _STAGE).tolist()
        x = np.linspace(left, right, 13)
        half = np.sqrt(np.maximum(_STAGE**2 - x**2, 0.0))
        for row in range(first[1], last[1] + 1):
            if (row + column) % 2:
                continue
            low, high = (np.clip(edge * _TILE - middle[1], -half, half) for edge in (row, row + 1))
            outline = np.zeros((2 * len(x), 3))
            outline[:, 0], outline[:, 2] = np.append(x, x[::-1]) + middle[0], np.append(low, high[::-1]) + middle[1]
            outlines.append(outline)
    places = camera.seen(np.concatenate(outlines))
    for start, end in pairwise(np.cumsum([0, *map(len, outlines)]).tolist()):
        brush.polygon(places[start:end], SOFT)


def draw_body(
    brush: Brush, camera: Camera, joints: Float64[np.ndarray, "31 3"], touching: Bool[np.ndarray, 4], colour: str
) -> None:
    """Draw a person, what is nearer over what is farther away; the left side of the body is lighter."""
    places, nearness = camera.seen(joints), camera.nearness(joints)
    parts = [((nearness[start] + nearness[end]) / 2, start, end, width) for start, end, width in _BONES]
    parts.append((nearness[_TRUNK].mean(), -1, -1, 9.0))
    (crown,) = camera.seen((joints[_HEAD] + 0.5 * (joints[_HEAD] - joints[_NECK]))[None])
    for _, start, end, width in sorted(parts):
        if start < 0:
            _draw_trunk(brush, camera.scale, places, crown, colour)
            continue
        line, thickness = [places[start], places[end]], width * camera.scale
        brush.line(line, "#ffffff", thickness + 2.4)
        brush.line(line, _mixed(colour, 0.5) if JOINTS[start].startswith("Left") else colour, thickness)
    for index in np.array(CONTACT_JOINTS)[touching].tolist():
        brush.disc(places[index], TOUCHED, 4)


def _draw_trunk(brush: Brush, scale: float, places: list[Point], crown: Point, colour: str) -> None:
    outline = [places[joint] for joint in _TRUNK]
    closed = [*outline, outline[0]]
    brush.line(closed, "#ffffff", 9.0 * scale + 2.4)
    brush.line([places[_CHEST], places[_HEAD]], colour, 7.0 * scale)
    brush.polygon(outline, colour)
    brush.line(closed, colour, 9.0 * scale)
    brush.disc(crown, "#ffffff", 10.5 * scale + 1.2)
    brush.disc(crown, colour, 10.5 * scale)


@cache
def _mixed(colour: str, share: float) -> str:
    """Return a colour of which only a share is left, the rest white."""
    return "#" + "".join(f"{round(255 + share * (value - 255)):02x}" for value in ImageColor.getrgb(colour)[:3])
