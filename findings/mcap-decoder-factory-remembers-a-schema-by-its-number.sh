#!/usr/bin/env bash
# One decoder factory of mcap-ros2-support or of mcap-protobuf-support, given to the readers of two logs, decodes the
# second log by the message definition of the first, without an error.
#
# Versions: Python 3.11, mcap 1.6.0, mcap-ros2-support 0.6.0, mcap-protobuf-support 0.6.0, protobuf 6.33.2.
#
# Behaviour: a factory keeps the decoder that it made under the schema's identifier alone. Identifiers are those of a
# file, and every writer begins with 1, so two logs of one robot, recorded before and after a definition changed, meet in
# it. Here a ROS 2 message has its two fields exchanged, and a protobuf message another field under number 1: the second
# log's left and right wheel change places, and its torque comes out as a speed. A factory for each file reads both right.
#
# Output seen:
#   ros2 one factory: left 1.0 right 2.0, left 4.0 right 3.0
#   ros2 a factory each: left 1.0 right 2.0, left 3.0 right 4.0
#   protobuf one factory: speed 1.5, speed 2.5
#   protobuf a factory each: speed 1.5, torque 2.5
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0 mcap-ros2-support==0.6.0 \
    mcap-protobuf-support==0.6.0 protobuf==6.33.2
"$folder/venv/bin/python" - "$folder" > "$folder/seen" <<'PYTHON'
import struct
import sys
from pathlib import Path

import mcap_protobuf.decoder
import mcap_ros2.decoder
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from mcap.reader import make_reader
from mcap.writer import Writer

FOLDER = Path(sys.argv[1])


def write(name, schema_name, encoding, definition, message_encoding, payload):
    """Write a log of one message."""
    with (FOLDER / name).open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema(schema_name, encoding, definition)
        channel = writer.register_channel("/state", message_encoding, schema)
        writer.add_message(channel, 1, payload, 1)
        writer.finish()
    return FOLDER / name


def read(path, factory):
    with path.open("rb") as file:
        ((*_, message),) = make_reader(file, decoder_factories=[factory]).iter_decoded_messages()
    return message


def definition(field):
    file = FileDescriptorProto(name="probe.proto", package="probe", syntax="proto3")
    double, one = FieldDescriptorProto.TYPE_DOUBLE, FieldDescriptorProto.LABEL_OPTIONAL
    file.message_type.add(name="State").field.add(name=field, number=1, type=double, label=one)
    return FileDescriptorSet(file=[file]).SerializeToString()


def wheels(message):
    return f"left {message.left} right {message.right}"


def value(message):
    return ", ".join(f"{field.name} {value}" for field, value in message.ListFields())


ROS = [
    write(f"ros-{index}.mcap", "probe/msg/Wheels", "ros2msg", text.encode(), "cdr", bytes([0, 1, 0, 0]) + packed)
    for index, (text, packed) in enumerate(
        [
            ("float64 left\nfloat64 right", struct.pack("<dd", 1.0, 2.0)),
            ("float64 right\nfloat64 left", struct.pack("<dd", 4.0, 3.0)),
        ]
    )
]
PROTOBUF = [
    write(
        f"protobuf-{index}.mcap", "probe.State", "protobuf", definition(field), "protobuf", struct.pack("<Bd", 9, number)
    )
    for index, (field, number) in enumerate([("speed", 1.5), ("torque", 2.5)])
]
for name, logs, new, shown in (
    ("ros2", ROS, mcap_ros2.decoder.DecoderFactory, wheels),
    ("protobuf", PROTOBUF, mcap_protobuf.decoder.DecoderFactory, value),
):
    one = new()
    print(f"{name} one factory:", ", ".join(shown(read(log, one)) for log in logs))
    print(f"{name} a factory each:", ", ".join(shown(read(log, new())) for log in logs))
PYTHON
cat "$folder/seen"
diff "$folder/seen" - <<'EXPECTED'
ros2 one factory: left 1.0 right 2.0, left 4.0 right 3.0
ros2 a factory each: left 1.0 right 2.0, left 3.0 right 4.0
protobuf one factory: speed 1.5, speed 2.5
protobuf a factory each: speed 1.5, torque 2.5
EXPECTED
echo "as described"
