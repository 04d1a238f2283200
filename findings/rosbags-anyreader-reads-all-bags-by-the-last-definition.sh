#!/usr/bin/env bash
# rosbags 0.11.9: an AnyReader of several bags decodes all of them by the definition that the last bag has of a type.
#
# Each bag holds the definitions of its messages and their digests (MD5 in ROS 1, RIHS01 in ROS 2), so that logs from before and after
# a change of a message can be read. AnyReader, which takes a list of bags, merges the definitions by the name of the type: the last one
# stays, and of the digests only that one is compared. Where two versions of a message are equally long (two fields that changed places,
# degrees that became radians, a reordered struct), messages of the other bags come out with the fields swapped, without a warning, and
# the other way round with the list reversed. Each bag in a reader of its own is read as it was written.
#
# Seen (rosbags 0.11.9, Python 3.11): two bags, in each one message with speed 1 and load 50, in this order of fields and in the other.
#   each alone: speed 1, load 50; together, the first bag's message: speed 50, load 1. ROS 1 and ROS 2 alike.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbags==0.11.9

cd "$folder"
"$folder/venv/bin/python" - <<'PYTHON'
import sys
from pathlib import Path

from rosbags import rosbag1, rosbag2
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

NAME = "arm_msgs/msg/State"
OLD, NEW = "float64 speed\nfloat64 load\n", "float64 load\nfloat64 speed\n"


def write(path: Path, definition: str, version: int) -> Path:
    """Write a bag with one message."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, NAME))
    message = store.types[NAME](speed=1.0, load=50.0)
    with rosbag1.Writer(path) if version == 1 else rosbag2.Writer(path, version=9) as bag:
        connection = bag.add_connection("/state", NAME, typestore=store)
        serialize = store.serialize_ros1 if version == 1 else store.serialize_cdr
        bag.write(connection, 1, serialize(message, NAME))
    return path


def read(*paths: Path) -> dict[str, tuple[float, float]]:
    """Return speed and load of each bag's message, by the name of the bag."""
    with AnyReader([*paths]) as reader:
        found = {}
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found[connection.owner.path.stem] = (message.speed, message.load)
    return found


RIGHT, SWAPPED = (1.0, 50.0), (50.0, 1.0)
as_described = True
for version, suffix in ((1, ".bag"), (2, "")):
    old, new = write(Path(f"old{version}{suffix}"), OLD, version), write(Path(f"new{version}{suffix}"), NEW, version)
    alone, together, reversed_ = read(old) | read(new), read(old, new), read(new, old)
    print(f"ROS {version}: alone {alone}, together {together}, reversed {reversed_}")
    as_described &= alone == {old.stem: RIGHT, new.stem: RIGHT}
    as_described &= together == {old.stem: SWAPPED, new.stem: RIGHT}
    as_described &= reversed_ == {old.stem: RIGHT, new.stem: SWAPPED}
sys.exit(0 if as_described else 1)
PYTHON
