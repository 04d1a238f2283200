#!/usr/bin/env bash
# Read backwards, messages of equal times come in another order from a pipe than from the same log as a file; and without
# the order of time a pipe is read forwards, where a file is an error.
#
# Versions: Python 3.11, mcap 1.6.0.
#
# Behaviour: make_reader takes a SeekingReader for what can seek and a NonSeekingReader for what cannot. With
# iter_messages(reverse=True) the first yields exactly the forward order turned round. The second sorts by time in
# descending order, with a sort that keeps the order of equals: messages of one time come forwards. With
# log_time_order=False the first refuses to read backwards, and the second does not mind reverse=True.
#
# Output seen:
#   forwards file 1 3 2 4 5
#   forwards pipe 1 3 2 4 5
#   backwards file 5 4 2 3 1
#   backwards pipe 2 4 5 3 1
#   backwards as written file ValueError
#   backwards as written pipe 1 2 3 4 5
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check mcap==1.6.0
cat > "$folder/probe.py" <<'PYTHON'
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

log = Path(sys.argv[1])
if not log.exists():
    with log.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("probe", "jsonschema", b"{}")
        channels = [writer.register_channel(topic, "json", schema) for topic in ("/left", "/right")]
        for number, (side, time) in enumerate([(0, 1), (1, 3), (0, 2), (1, 3), (0, 3)], start=1):
            writer.add_message(channels[side], time, str(number).encode(), time)
        writer.finish()
    sys.exit()
source = sys.argv[2]
stream = log.open("rb") if source == "file" else sys.stdin.buffer
options = {
    "forwards": {},
    "backwards": {"reverse": True},
    "backwards as written": {"reverse": True, "log_time_order": False},
}[sys.argv[3]]
try:
    found = " ".join(message.data.decode() for _, _, message in make_reader(stream).iter_messages(**options))
except ValueError:
    found = "ValueError"
print(sys.argv[3], source, found)
PYTHON
python="$folder/venv/bin/python"
"$python" "$folder/probe.py" "$folder/log.mcap"
for order in forwards backwards "backwards as written"; do
    "$python" "$folder/probe.py" "$folder/log.mcap" file "$order"
    cat "$folder/log.mcap" | "$python" "$folder/probe.py" "$folder/log.mcap" pipe "$order"
done > "$folder/seen"
cat "$folder/seen"
diff "$folder/seen" - <<'EXPECTED'
forwards file 1 3 2 4 5
forwards pipe 1 3 2 4 5
backwards file 5 4 2 3 1
backwards pipe 2 4 5 3 1
backwards as written file ValueError
backwards as written pipe 1 2 3 4 5
EXPECTED
echo "as described"
