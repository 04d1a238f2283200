#!/usr/bin/env bash
# A ROS 2 message in XCDR2, which MCAP's registry allows under the encoding `cdr`, is decoded by mcap-ros2-support as if it
# were XCDR1, without an error: eight-byte numbers come out as other numbers.
#
# Versions: Python 3.11, mcap-ros2-support 0.6.0, mcap 1.6.0.
#
# Behaviour: the second byte of a payload says how it is encoded (1: XCDR1, 7: XCDR2, 9: XCDR2 with a length in front, all
# little-endian). The reader takes the last bit of it as the byte order and nothing else. XCDR2 aligns eight-byte numbers
# to four bytes where XCDR1 aligns them to eight, so behind an int32 the float64 is looked for four bytes too late, and
# what stands behind it is read in its place. Of a message with a length in front (kind 9) the length becomes the first
# field; here it also makes up for the four bytes, so that the others look right.
#
# Output seen:
#   kind 1 n 7 x 2.5 m 9 tail 0
#   kind 7 n 7 x 2e-313 m 0 tail 0
#   kind 9 n 20 x 2.5 m 9 tail 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap-ros2-support==0.6.0 mcap==1.6.0
"$folder/venv/bin/python" - > "$folder/seen" <<'PYTHON'
import struct

from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory

TEXT = "int32 n\nfloat64 x\nint32 m\nint32 tail"
schema = Schema(id=1, name="probe/msg/Mixed", encoding="ros2msg", data=TEXT.encode())
decode = DecoderFactory().decoder_for("cdr", schema)
values = (7, 2.5, 9, 0)
packed = struct.pack("<idii", *values)
payloads = {
    1: struct.pack("<i4xdii", *values),
    7: packed + bytes(4),
    9: struct.pack("<I", len(packed)) + packed,
}
for kind, body in payloads.items():
    found = decode(bytes([0, kind, 0, 0]) + body)
    print("kind", kind, "n", found.n, "x", f"{found.x:.2g}", "m", found.m, "tail", found.tail)
PYTHON
cat "$folder/seen"
diff "$folder/seen" - <<'EXPECTED'
kind 1 n 7 x 2.5 m 9 tail 0
kind 7 n 7 x 2e-313 m 0 tail 0
kind 9 n 20 x 2.5 m 9 tail 0
EXPECTED
echo "as described"
