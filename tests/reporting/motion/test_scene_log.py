"""Scenes of people: what a reader who knows nothing but the file finds in it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader

from addressed_dynamics.base.errors import ReportError
from addressed_dynamics.episodes.layout import JOINTS, PARENTS
from addressed_dynamics.reporting.common.foxglove import message_class
from addressed_dynamics.reporting.motion.actors import Actor
from addressed_dynamics.reporting.motion.scene_log import to_scene, write_scene

FRAMES = 7


@pytest.fixture
def actor() -> Actor:
    """Someone whose joints are anywhere, some of them where their parents are."""
    generator = np.random.default_rng(4)
    positions = generator.normal(0, 60, (FRAMES, len(JOINTS), 3))
    positions[:, JOINTS.index("LHipJoint")] = positions[:, JOINTS.index("Hips")]
    positions[:, JOINTS.index("LeftLeg")] = positions[:, JOINTS.index("LeftUpLeg")] - [0, 40, 0]
    return Actor("ours", positions, generator.random((FRAMES, 4)))


def messages(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """Time and message by topic, read with nothing but the schemas that the file brings along."""
    found: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            assert schema is not None
            assert (schema.encoding, channel.message_encoding) == ("protobuf", "protobuf")
            pool = DescriptorPool()
            for each in FileDescriptorSet.FromString(schema.data).file:
                pool.Add(each)
            kind = GetMessageClass(pool.FindMessageTypeByName(schema.name))
            found.setdefault(channel.topic, []).append((message.log_time, kind.FromString(message.data)))
    return found


def point(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def turned(quaternion: Any, vector: list[float]) -> np.ndarray:
    """A vector turned by a quaternion."""
    part, cross = np.array(point(quaternion)), np.cross
    return np.array(vector) + 2 * cross(part, cross(part, vector) + quaternion.w * np.array(vector))


def test_joints_are_spheres_where_they_are(tmp_path: Path, actor: Actor) -> None:
    write_scene(tmp_path / "scene.mcap", [actor])
    scenes = messages(tmp_path / "scene.mcap")["/scene"]
    assert [time for time, _ in scenes] == [round(1e9 * index / 60) for index in range(FRAMES)]
    for index, (time, scene) in enumerate(scenes):
        (body,) = scene.entities
        assert (body.id, body.frame_id) == ("ours", "world")
        assert 10**9 * body.timestamp.seconds + body.timestamp.nanos == time
        places = np.array([point(sphere.pose.position) for sphere in body.spheres])
        x, y, z = actor.positions[index].T
        assert np.allclose(places, np.stack([z, x, y], axis=1) / 100, atol=1e-12), "z is up, x ahead, y to the left"


def test_bones_are_cylinders_from_joint_to_joint(tmp_path: Path, actor: Actor) -> None:
    write_scene(tmp_path / "scene.mcap", [actor])
    for index, (_, scene) in enumerate(messages(tmp_path / "scene.mcap")["/scene"]):
        ends = to_scene(actor.positions[index])
        bones = [(parent, joint) for joint, parent in enumerate(PARENTS) if joint not in (0, JOINTS.index("LHipJoint"))]
        cylinders = scene.entities[0].cylinders
        assert len(cylinders) == len(bones), "all but the one without length"
        for (parent, joint), cylinder in zip(bones, cylinders, strict=True):
            half = turned(cylinder.pose.orientation, [0, 0, cylinder.size.z / 2])
            assert np.allclose(point(cylinder.pose.position) - half, ends[parent], atol=1e-6)
            assert np.allclose(point(cylinder.pose.position) + half, ends[joint], atol=1e-6)


def test_feet_that_touch_the_ground_have_another_colour(tmp_path: Path, actor: Actor) -> None:
    write_scene(tmp_path / "scene.mcap", [actor])
    assert actor.contacts is not None
    feet = [JOINTS.index(joint) for joint in ("LeftFoot", "LeftToeBase", "RightFoot", "RightToeBase")]
    for index, (_, scene) in enumerate(messages(tmp_path / "scene.mcap")["/scene"]):
        spheres = scene.entities[0].spheres
        green = [spheres[foot].color != spheres[0].color for foot in feet]
        assert green == (actor.contacts[index] > 0.5).tolist()


def test_an_arrow_shows_the_command_and_is_gone_where_that_is_to_stand(tmp_path: Path, actor: Actor) -> None:
    commands = np.tile([1.5, -2.0], (FRAMES, 1))
    commands[3] = 0
    write_scene(tmp_path / "scene.mcap", [actor], commands)
    for index, (_, scene) in enumerate(messages(tmp_path / "scene.mcap")["/scene"]):
        entity = scene.entities[1]
        assert entity.id == "ours: command"
        assert len(entity.arrows) == (index != 3)
        for arrow in entity.arrows:
            way = turned(arrow.pose.orientation, [arrow.shaft_length + arrow.head_length, 0, 0])
            assert np.allclose(way, 0.24 * np.array([-2.0, 1.5, 0]))


def test_a_frame_on_the_ground_goes_along(tmp_path: Path, actor: Actor) -> None:
    write_scene(tmp_path / "scene.mcap", [actor])
    for index, (_, message) in enumerate(messages(tmp_path / "scene.mcap")["/tf"]):
        (frame,) = message.transforms
        assert (frame.parent_frame_id, frame.child_frame_id) == ("world", "ours")
        assert np.allclose(point(frame.translation), to_scene(actor.positions[index, 0]) * [1, 1, 0])
        left, right = (to_scene(actor.positions[index, JOINTS.index(f"{side}UpLeg")]) for side in ("Left", "Right"))
        across = (left - right) * [1, 1, 0]
        assert np.allclose(turned(frame.rotation, [0, 1, 0]), across / np.linalg.norm(across))


def test_two_people_stand_apart_under_their_names(tmp_path: Path, actor: Actor) -> None:
    write_scene(tmp_path / "scene.mcap", [actor, Actor("theirs", actor.positions)], apart=2.5)
    found = messages(tmp_path / "scene.mcap")
    ours, theirs = found["/scene"][2][1].entities
    assert (ours.id, theirs.id) == ("ours", "theirs")
    shift = np.array(point(theirs.spheres[9].pose.position)) - point(ours.spheres[9].pose.position)
    assert np.allclose(shift, [0, 2.5, 0])
    assert [frame.child_frame_id for frame in found["/tf"][2][1].transforms] == ["ours", "theirs"]


def test_messages_are_those_of_the_published_schemas() -> None:
    # Written with the package foxglove-schemas-protobuf 0.4.0.
    scene = message_class("SceneUpdate").FromString(
        bytes.fromhex(
            "0a0510011a016212580a04080310051205776f726c641a01613a0921000000000000c03f4a230a0b0a0909000000000000f83f1209"
            "11000000000000e03f1a0921000000000000f03f52160a0b120921000000000000f03f21000000000000d03f"
        )
    )
    (entity,) = scene.entities
    assert (entity.id, entity.frame_id, entity.timestamp.seconds, entity.timestamp.nanos) == ("a", "world", 3, 5)
    assert (entity.spheres[0].pose.position.x, entity.spheres[0].size.y, entity.spheres[0].color.a) == (1.5, 0.5, 1)
    assert (entity.cylinders[0].pose.orientation.w, entity.cylinders[0].top_scale) == (1, 0.25)
    assert entity.arrows[0].head_length == 0.125
    assert (scene.deletions[0].id, scene.deletions[0].type) == ("b", 1)
    (transform,) = (
        message_class("FrameTransforms")
        .FromString(
            bytes.fromhex("0a201205776f726c641a016122091900000000000000402a0921000000000000f03f"),
        )
        .transforms
    )
    assert (transform.parent_frame_id, transform.child_frame_id) == ("world", "a")
    assert (transform.translation.z, transform.rotation.w) == (2, 1)


def test_the_same_motion_makes_the_same_bytes_and_what_cannot_be_shown_makes_no_file(
    tmp_path: Path, actor: Actor
) -> None:
    for name in ("one.mcap", "other.mcap"):
        write_scene(tmp_path / name, [actor])
    assert (tmp_path / "one.mcap").read_bytes() == (tmp_path / "other.mcap").read_bytes()
    actor.positions[4, 2, 1] = np.inf
    with pytest.raises(ReportError, match=r"'ours'.*not finite"):
        write_scene(tmp_path / "broken.mcap", [actor])
    assert {path.name for path in tmp_path.iterdir()} == {"one.mcap", "other.mcap"}
