"""Motion as an MCAP log of a scene, which Foxglove and Lichtblick play in three dimensions.

People are cylinders and spheres in messages `foxglove.SceneUpdate`, and each has a frame of its own in messages
`foxglove.FrameTransforms`, which a camera can follow. The scene is in metres, z upwards, x where a heading of 0 points.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Float64
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import CompressionType, Writer
from PIL import ImageColor

from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.episodes.layout import FRAME_RATE, JOINTS, PARENTS
from addressed_dynamics.reporting.common.foxglove import message_class, schemas
from addressed_dynamics.reporting.motion.actors import (
    ARROW_FRAMES,
    ASKED,
    BODIES,
    CONTACT_JOINTS,
    TOUCHED,
    Actor,
    check_actors,
    facing,
)

SCENE, FRAMES = "/scene", "/tf"
"""Topics of the people, and of the frames that go along with them."""
WORLD = "world"
"""The frame of the ground."""

_BONE, _JOINT, _HEAD = 0.07, 0.08, 0.2
"""Thickness of bones, and size of joints and of a head, in m."""
_SHORTEST = 0.01
"""Bones that never get longer, in m, are not drawn: some joints sit where their parents do."""


def to_scene(points: Float[np.ndarray, "*any 3"]) -> Float64[np.ndarray, "*any 3"]:
    """Return points of the motion (cm, y up, z ahead, x to the left) in the scene (m, z up, x ahead, y to the left)."""
    scene: Float64[np.ndarray, "*any 3"] = points[..., [2, 0, 1]].astype(np.float64) / 100
    return scene


def write_scene(
    path: Path, actors: Sequence[Actor], commands: Float[np.ndarray, "time 2"] | None = None, *, apart: float = 0.0
) -> None:
    """Write a log of what people do, from time 0 on, atomically.

    Args:
        path: the MCAP file.
        actors: one or two people over the same time; a joint is green while it touches the ground.
        commands: velocity that is asked for in the world, x and z in cm/frame; None to show none.
        apart: how far to the left of where it is to draw the second person, in m: two who obey the same commands would
            walk in each other.

    Raises:
        ReportError: there are no actors or more than two, they differ in length or share a title, or a position is
            not finite.
    """
    check_actors(actors, commands)
    people = [
        _Person(actor, colour, np.array([0.0, apart * index, 0.0]))
        for index, (actor, colour) in enumerate(zip(actors, BODIES, strict=False))
    ]
    scene, frames = message_class("SceneUpdate"), message_class("FrameTransforms")
    schema = schemas().SerializeToString(deterministic=True)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, use_summary_offsets=False)
        writer.start(library="addressed-dynamics")
        channels = [
            writer.register_channel(
                topic, MessageEncoding.Protobuf, writer.register_schema(kind, SchemaEncoding.Protobuf, schema)
            )
            for topic, kind in ((FRAMES, frames.DESCRIPTOR.full_name), (SCENE, scene.DESCRIPTOR.full_name))
        ]
        for index in range(len(actors[0].positions)):
            nanoseconds = round(1e9 * index / FRAME_RATE)
            moved = frames(transforms=[person.frame(index, nanoseconds) for person in people])
            shown = scene(entities=[person.body(index, nanoseconds) for person in people])
            if commands is not None:
                shown.entities.extend(person.command(index, nanoseconds, commands[index]) for person in people)
            for channel, message in zip(channels, (moved, shown), strict=True):
                writer.add_message(channel, nanoseconds, message.SerializeToString(deterministic=True), nanoseconds)
        writer.finish()


class _Person:
    """Makes the messages of one person; those of a body are one message that changes from frame to frame."""

    def __init__(self, actor: Actor, colour: str, shift: Float64[np.ndarray, 3]) -> None:
        self._title = actor.title
        self._joints = to_scene(actor.positions) + shift
        self._touching = actor.touching()
        self._headings = facing(actor.positions)
        parents = np.array(PARENTS)
        along = self._joints - self._joints[:, parents]
        lengths = np.linalg.norm(along, axis=2)
        bones = np.flatnonzero((lengths.max(axis=0) > _SHORTEST) & (parents >= 0))
        self._lengths = lengths[:, bones]
        self._middles = (self._joints - along / 2)[:, bones]
        self._turns = _from_z(along[:, bones] / np.maximum(lengths[:, bones, None], 1e-9))
        self._colour, self._touched = _colour(colour), _colour(TOUCHED)
        self._body = message_class("SceneEntity")(frame_id=WORLD, id=actor.title)
        for joint in JOINTS:
            size = _HEAD if joint == "Head" else _JOINT
            self._body.spheres.add(size={"x": size, "y": size, "z": size}, color=self._colour)
        for _ in bones:
            self._body.cylinders.add(size={"x": _BONE, "y": _BONE}, bottom_scale=1.0, top_scale=1.0, color=self._colour)

    def body(self, index: int, nanoseconds: int) -> Any:
        """Return the `SceneEntity` of the body: a sphere for each joint, a cylinder for each bone."""
        _stamp(self._body.timestamp, nanoseconds)
        for sphere, place in zip(self._body.spheres, self._joints[index].tolist(), strict=True):
            _place(sphere.pose.position, place)
        for joint, touches in zip(CONTACT_JOINTS, self._touching[index].tolist(), strict=True):
            self._body.spheres[joint].color.CopyFrom(self._touched if touches else self._colour)
        bones = (each[index].tolist() for each in (self._middles, self._turns, self._lengths))
        for cylinder, place, turn, length in zip(self._body.cylinders, *bones, strict=True):
            _place(cylinder.pose.position, place)
            _turn(cylinder.pose.orientation, turn)
            cylinder.size.z = length
        return self._body

    def frame(self, index: int, nanoseconds: int) -> Any:
        """Return the `FrameTransform` of a frame on the ground that faces where the person does."""
        transform = message_class("FrameTransform")(parent_frame_id=WORLD, child_frame_id=self._title)
        _stamp(transform.timestamp, nanoseconds)
        _place(transform.translation, self._ground(index))
        _turn(transform.rotation, _about_z(float(self._headings[index])))
        return transform

    def command(self, index: int, nanoseconds: int, command: Float[np.ndarray, 2]) -> Any:
        """Return the `SceneEntity` of the arrow that shows the command; it is empty where that is to stand."""
        entity = message_class("SceneEntity")(frame_id=WORLD, id=f"{self._title}: command")
        _stamp(entity.timestamp, nanoseconds)
        x, z = command.tolist()
        length = ARROW_FRAMES * math.hypot(x, z) / 100
        if length > 0.01:
            head = min(0.12, length)
            arrow = entity.arrows.add(
                shaft_length=length - head,
                shaft_diameter=0.04,
                head_length=head,
                head_diameter=0.1,
                color=_colour(ASKED),
            )
            _place(arrow.pose.position, self._ground(index))
            _turn(arrow.pose.orientation, _about_z(math.atan2(x, z)))
        return entity

    def _ground(self, index: int) -> list[float]:
        x, y, _ = self._joints[index, 0].tolist()
        return [x, y, 0.0]


def _from_z(directions: Float64[np.ndarray, "*any 3"]) -> Float64[np.ndarray, "*any 4"]:
    """Return the shortest turns from the z axis to `directions`, as quaternions x, y, z, w."""
    x, y, z = np.moveaxis(directions, -1, 0)
    # Straight down, the way to turn is anyone's choice.
    down = z < -1 + 1e-9
    turns = np.stack(
        [np.where(down, 1.0, -y), np.where(down, 0.0, x), np.zeros_like(x), np.where(down, 0.0, 1 + z)], -1
    )
    normalised: Float64[np.ndarray, "*any 4"] = turns / np.linalg.norm(turns, axis=-1, keepdims=True)
    return normalised


def _about_z(angle: float) -> list[float]:
    return [0.0, 0.0, math.sin(angle / 2), math.cos(angle / 2)]


def _stamp(timestamp: Any, nanoseconds: int) -> None:
    timestamp.seconds, timestamp.nanos = divmod(nanoseconds, 10**9)


def _place(vector: Any, place: Sequence[float]) -> None:
    vector.x, vector.y, vector.z = place


def _turn(quaternion: Any, turn: Sequence[float]) -> None:
    quaternion.x, quaternion.y, quaternion.z, quaternion.w = turn


def _colour(colour: str) -> Any:
    red, green, blue = (value / 255 for value in ImageColor.getrgb(colour)[:3])
    return message_class("Color")(r=red, g=green, b=blue, a=1.0)
