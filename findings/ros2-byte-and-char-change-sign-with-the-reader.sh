#!/usr/bin/env bash
# Of one ROS 2 message, two readers for Python make numbers of different signs: each takes one of the two one-byte types
# of a message definition as signed, and not the same one.
#
# Versions: Python 3.11, rosbags 0.11.9, mcap-ros2-support 0.6.0, mcap 1.6.0.
#
# Behaviour: a `.msg` file may have fields of the types `byte` and `char`. In ROS 2 both are one unsigned byte: rosidl maps
# `byte` to IDL's octet and `char` to uint8. A message of both with the value 200 is, on the wire, the bytes c8 c8.
#   mcap-ros2-support: byte 200, char -56; char[] likewise (an array of type 'b').
#   rosbags:           byte -56, char 200; byte[] likewise (an array of int8), char[] is an array of uint8.
# Neither raises, so whoever changes from one library to the other, or reads .db3 with one and .mcap with the other, gets
# other numbers from the same log. And a value that one of them reads, the other one refuses to write.
#
# Output seen:
#   mcap-ros2-support byte 200 char -56 byte[] 200 char[] -56
#   rosbags byte -56 char 200 byte[] -56 char[] 200
#   rosbags writes byte 200: error: byte format requires -128 <= number <= 127
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check rosbags==0.11.9 mcap-ros2-support==0.6.0 mcap==1.6.0
"$folder/venv/bin/python" - > "$folder/seen" <<'PYTHON'
import struct

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TEXT = "byte b\nchar c\nbyte[] bs\nchar[] cs"
# The header of plain CDR, little-endian; two bytes; after padding to four, each array with its length before it.
message = b"\0\1\0\0" + b"\xc8\xc8\0\0" + struct.pack("<I", 1) + b"\xc8\0\0\0" + struct.pack("<I", 1) + b"\xc8"

decode = DecoderFactory().decoder_for("cdr", Schema(id=1, name="probe/msg/Bytes", encoding="ros2msg", data=TEXT.encode()))
found = decode(message)
print("mcap-ros2-support byte", found.b, "char", found.c, "byte[]", found.bs[0], "char[]", found.cs[0])

store = get_typestore(Stores.EMPTY)
store.register(get_types_from_msg(TEXT, "probe/msg/Bytes"))
found = store.deserialize_cdr(message, "probe/msg/Bytes")
print("rosbags byte", found.b, "char", found.c, "byte[]", found.bs[0], "char[]", found.cs[0])

found.b = 200
try:
    store.serialize_cdr(found, "probe/msg/Bytes")
    print("rosbags writes byte 200")
except Exception as error:
    print("rosbags writes byte 200: error:", error)
PYTHON
cat "$folder/seen"
diff "$folder/seen" - <<'EXPECTED'
mcap-ros2-support byte 200 char -56 byte[] 200 char[] -56
rosbags byte -56 char 200 byte[] -56 char[] 200
rosbags writes byte 200: error: byte format requires -128 <= number <= 127
EXPECTED
echo "as described"
