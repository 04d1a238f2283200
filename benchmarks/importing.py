"""Import of foreign logs, against mcap's own reader that decodes the same messages; of several, by two processes."""

import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

from google.protobuf.descriptor_pb2 import FieldDescriptorProto as Field
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.reader import make_reader
from mcap.records import Schema
from mcap.writer import Writer
from mcap_ros2.decoder import DecoderFactory
from mcap_ros2.writer import Writer as Ros2Writer
from measuring import median_ratio, print_table, take_turns
from pydantic import TypeAdapter

from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.importing import import_logs

SECONDS = 1_000
LOGS = 8
"""Logs that several processes import."""
ROUNDS = 3
SOURCE = {
    "kind": "mcap",
    "observation": {"joint": {"field": "/joint_states.position[0:2]"}},
    "action": {"continuous": {"torque": {"field": "/command.torque"}}},
    "reward": None,
    "rate_hz": 20.0,
    "tolerance_s": 0.1,
    "episode": {"by": "file"},
    "min_length": 2,
}
Message = tuple[str, int, dict[str, object]]


def messages() -> list[Message]:
    """Return states at 20 Hz and commands at 12.5 Hz, in order of time."""
    states = [("/joint_states", i * 50_000_000, {"position": [i / 7, i % 3]}) for i in range(SECONDS * 20)]
    commands = [("/command", i * 80_000_000 + 1, {"torque": i / 4}) for i in range(SECONDS * 25 // 2)]
    return sorted([*states, *commands], key=lambda message: message[1])


def write_json_log(path: Path) -> None:
    """Write the messages as JSON."""
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channels = {topic: writer.register_channel(topic, "json", 0) for topic in ("/joint_states", "/command")}
        for topic, time, message in messages():
            writer.add_message(channels[topic], time, json.dumps(message).encode(), time)
        writer.finish()


def write_protobuf_log(path: Path) -> None:
    """Write the messages in protobuf."""
    proto = FileDescriptorProto(name="arm.proto", package="arm", syntax="proto3")
    for name, field, label in (
        ("State", "position", Field.LABEL_REPEATED),
        ("Command", "torque", Field.LABEL_OPTIONAL),
    ):
        proto.message_type.add(name=name).field.add(name=field, number=1, label=label, type=Field.TYPE_DOUBLE)
    pool = DescriptorPool()
    pool.Add(proto)
    definition = FileDescriptorSet(file=[proto]).SerializeToString()
    names = {"/joint_states": "arm.State", "/command": "arm.Command"}
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        kinds, channels = {}, {}
        for topic, name in names.items():
            kinds[topic] = GetMessageClass(pool.FindMessageTypeByName(name))
            schema = writer.register_schema(name, "protobuf", definition)
            channels[topic] = writer.register_channel(topic, "protobuf", schema)
        for topic, time, message in messages():
            writer.add_message(channels[topic], time, kinds[topic](**message).SerializeToString(), time)
        writer.finish()


def write_ros2_log(path: Path) -> None:
    """Write the messages as ROS 2 does."""
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        state, command = (
            writer.register_msgdef(*kind)
            for kind in (("a/State", "float64[] position"), ("a/Command", "float32 torque"))
        )
        schemas = {"/joint_states": state, "/command": command}
        for topic, time, message in messages():
            writer.write_message(topic, schemas[topic], message, time, time)
        writer.finish()


def decode_only(path: Path) -> None:
    """Decode every message with mcap's reader, and keep nothing."""
    factory, kinds = DecoderFactory(), dict[int, Callable[[bytes], object]]()
    with path.open("rb") as file:
        for schema, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            if channel.id not in kinds:
                kinds[channel.id] = _protobuf(schema) if channel.message_encoding == "protobuf" else json.loads
            decode = factory.decoder_for(channel.message_encoding, schema) or kinds[channel.id]
            decode(message.data)


def _protobuf(schema: Schema | None) -> Callable[[bytes], object]:
    assert schema is not None
    pool = DescriptorPool()
    for each in FileDescriptorSet.FromString(schema.data).file:
        pool.Add(each)
    decode: Callable[[bytes], object] = GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString
    return decode


def main() -> None:
    """Print the time of each, and the ratios."""
    rows = []
    count = len(messages())
    for name, write in {"JSON": write_json_log, "protobuf": write_protobuf_log, "ROS 2": write_ros2_log}.items():
        with tempfile.TemporaryDirectory() as folder:
            log = Path(folder) / "log.mcap"
            write(log)
            source = TypeAdapter(SourceParams).validate_json(json.dumps(SOURCE | {"files": [str(log)]}))
            contestants = {
                "import": lambda source=source, folder=folder: import_logs(
                    source, Path(folder) / "out", name="benchmark", progress=lambda _: None
                ),
                "decode": lambda log=log: decode_only(log),
            }
            seconds = take_turns(contestants, rounds=ROUNDS)
        each = 1e6 * min(seconds["import"].wall) / count
        ratio = median_ratio(seconds["import"].wall, seconds["decode"].wall)
        rows.append([f"{count:,} messages, {name}", f"{each:.1f} µs", f"{ratio:.2f}x"])
    print_table(["log", "import, a message", "of decoding alone"], rows)
    together()


def together() -> None:
    """Print the time that two processes need for some logs of ROS 2, and its ratio to that of one."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_ros2_log(folder / "0.mcap")
        for number in range(1, LOGS):
            shutil.copy(folder / "0.mcap", folder / f"{number}.mcap")
        source = TypeAdapter(SourceParams).validate_json(json.dumps(SOURCE | {"files": [str(folder / "*.mcap")]}))
        contestants = {
            str(cores): lambda cores=cores: import_logs(
                source, folder / f"out-{cores}", name="benchmark", progress=lambda _: None, cores=cores
            )
            for cores in (1, 2)
        }
        seconds = take_turns(contestants, rounds=ROUNDS)
        same = all(
            (folder / "out-2" / path.name).read_bytes() == path.read_bytes() for path in (folder / "out-1").iterdir()
        )
    ratio = median_ratio(seconds["2"].wall, seconds["1"].wall)
    print(f"\n{LOGS} of these logs by two processes: {min(seconds['2'].wall):.1f} s, {ratio:.2f}x of one process; "
          f"the same bytes: {'yes' if same else 'NO'}")  # fmt: skip


if __name__ == "__main__":
    main()
