"""Logs as other programs write them: two topics, each with its own rate, in three encodings."""

import io
import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.json_format import ParseDict
from google.protobuf.message_factory import GetMessageClass
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as Ros2Writer
from pydantic import TypeAdapter

from addressed_dynamics.base.params.source import SourceParams

SECOND = 10**9
ROS2 = {"/joint_states": ("arm/State", "float64[] position\nstring name"), "/cmd": ("arm/Command", "float32 torque")}
SOURCE = {
    "kind": "mcap",
    "files": ["logs/*.mcap"],
    "observation": {"joint": {"field": "/joint_states.position[0:2]", "unit": "rad", "low": -1.0, "high": 100.0}},
    "action": {"continuous": {"torque": {"field": "/cmd.torque", "unit": "N m"}}},
    "reward": None,
    "rate_hz": 10.0,
    "tolerance_s": 0.15,
    "episode": {"by": "file"},
    "min_length": 2,
}
"""What is imported of the logs below."""

Timed = tuple[str, int, Any]
"""Topic, time in nanoseconds, and message."""


def source(**changes: Any) -> SourceParams:
    """`SOURCE` with other values under some keys; `...` leaves a key out."""
    section = {key: value for key, value in (SOURCE | changes).items() if value is not ...}
    return TypeAdapter(SourceParams).validate_json(json.dumps(section))


def states_and_commands(seconds: float = 1.0, start: int = 100 * SECOND) -> list[Timed]:
    """The state every 50 ms, beginning at `start`, and a command every 80 ms, 20 ms later, in the order of time."""
    end = start + round(seconds * SECOND)
    states: list[Timed] = [
        ("/joint_states", at, {"position": [(at - start) / SECOND, i % 3], "name": "arm"})
        for i, at in enumerate(range(start, end + 1, SECOND // 20))
    ]
    commands: list[Timed] = [
        ("/cmd", at, {"torque": i / 4}) for i, at in enumerate(range(start + SECOND // 50, end + 1, 2 * SECOND // 25))
    ]
    return sorted(states + commands, key=lambda timed: timed[1])


def json_log(messages: Iterable[Timed], **options: Any) -> bytes:
    """An MCAP file of JSON messages without schemas."""
    file = io.BytesIO()
    writer = Writer(file, **options)
    writer.start()
    channels: dict[str, int] = {}
    for topic, time, message in messages:
        channel = channels.get(topic) or writer.register_channel(topic, "json", 0)
        channels[topic] = channel
        data = message if isinstance(message, bytes) else json.dumps(message).encode()
        writer.add_message(channel, time, data, time)
    writer.finish()
    return file.getvalue()


def protobuf_log(messages: Iterable[Timed]) -> bytes:
    """An MCAP file of protobuf messages; their definition is in two files, the dependent one first."""
    point = DescriptorProto(name="Name")
    _add(point, "text", FieldDescriptorProto.TYPE_STRING)
    state, command = DescriptorProto(name="State"), DescriptorProto(name="Command")
    _add(state, "position", FieldDescriptorProto.TYPE_DOUBLE, repeated=True)
    _add(state, "name", FieldDescriptorProto.TYPE_STRING)
    _add(command, "torque", FieldDescriptorProto.TYPE_FLOAT)
    _add(command, "who", FieldDescriptorProto.TYPE_MESSAGE, type_name=".arm.Name")
    base = FileDescriptorProto(name="base.proto", package="arm", syntax="proto3", message_type=[point])
    main = FileDescriptorProto(
        name="arm.proto", package="arm", syntax="proto3", message_type=[state, command], dependency=["base.proto"]
    )
    pool = DescriptorPool()
    pool.Add(base)
    pool.Add(main)
    definition = FileDescriptorSet(file=[main, base]).SerializeToString(deterministic=True)
    file = io.BytesIO()
    writer = Writer(file)
    writer.start()
    channels, kinds = {}, {}
    for topic, name in (("/joint_states", "arm.State"), ("/cmd", "arm.Command")):
        schema = writer.register_schema(name, "protobuf", definition)
        channels[topic] = writer.register_channel(topic, "protobuf", schema)
        kinds[topic] = GetMessageClass(pool.FindMessageTypeByName(name))
    for topic, time, message in messages:
        data = ParseDict(message, kinds[topic]()).SerializeToString()
        writer.add_message(channels[topic], time, data, time)
    writer.finish()
    return file.getvalue()


def ros2_log(messages: Iterable[Timed]) -> bytes:
    """An MCAP file of ROS 2 messages."""
    file = io.BytesIO()
    writer = Ros2Writer(file, compression=CompressionType.LZ4)
    schemas = {topic: writer.register_msgdef(name, text) for topic, (name, text) in ROS2.items()}
    for topic, time, message in messages:
        writer.write_message(topic, schemas[topic], message, time, time)
    writer.finish()
    return file.getvalue()


def save(folder: Path, **files: bytes) -> Path:
    """Write `logs/<name>.mcap` files under `folder`."""
    (folder / "logs").mkdir(exist_ok=True)
    for name, data in files.items():
        (folder / "logs" / f"{name}.mcap").write_bytes(data)
    return folder


def _add(
    message: DescriptorProto,
    name: str,
    kind: FieldDescriptorProto.Type.ValueType,
    *,
    repeated: bool = False,
    type_name: str = "",
) -> None:
    label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
    field = message.field.add(name=name, number=len(message.field) + 1, type=kind, label=label)
    if type_name:
        field.type_name = type_name
