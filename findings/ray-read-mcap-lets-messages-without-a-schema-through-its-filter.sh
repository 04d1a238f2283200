#!/usr/bin/env bash
# ray 2.60.0: read_mcap(message_types={"Pose"}) also gives every message of a channel that has no schema, and fields of others.
#
# MCAP lets a channel go without a schema, which is usual for JSON. The filter by message types, documented as "Only messages with
# matching schema names will be read", asks a message for its schema's name only if it has a schema: all others pass. And an empty set of
# topics or of types, what a filter that was computed may come to, is no filter: it gives all messages, not none.
#
# What is read beside a topic also changes its rows: messages in JSON are decoded into one column, whose fields are those of all topics,
# null where a message has none such, and whose numbers are of one type: an integer of one topic becomes a float because another topic has
# a float of that name. Whether a field was absent, null, or of another topic cannot be told any more.
#
# Seen (ray 2.60.0, mcap 1.4.0, pyarrow 25.0.1, pandas 3.1.1, Python 3.11), on three channels in JSON, /note without a schema:
#   message_types={"Pose"}: rows of /note and /pose; topics=set(): rows of all three topics
#   /pose read alone: {'x': 0}; read with /temp and /note: {'x': 0.0, 'celsius': None, 'text': None}
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
    ray==2.60.0 mcap==1.4.0 pyarrow==25.0.1 pandas==3.1.1 numpy==2.4.6

cd "$folder"
cat > read.py <<'PYTHON'
import json
import sys

import ray
from mcap.writer import Writer

with open("log.mcap", "wb") as file:
    writer = Writer(file)
    writer.start()
    channels = {}
    for topic, name in (("/pose", "Pose"), ("/temp", "Temperature"), ("/note", None)):
        schema = writer.register_schema(name, "jsonschema", b"{}") if name else 0
        channels[topic] = writer.register_channel(topic, "json", schema)
    said = (("/pose", {"x": 0}), ("/temp", {"x": 0.5, "celsius": 20}), ("/note", {"text": "warm"}))
    for time, (topic, message) in enumerate(said):
        writer.add_message(channels[topic], log_time=time, publish_time=time, data=json.dumps(message).encode())
    writer.finish()

ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR", _temp_dir=sys.argv[1])
ray.data.DataContext.get_current().enable_progress_bars = False


def read(**filters: object) -> dict[str, object]:
    """Return what is read of the log, by topic."""
    rows = ray.data.read_mcap("log.mcap", include_metadata=False, **filters).take_all()
    return {row["topic"]: row["data"] for row in rows}


by_type, by_nothing, alone = read(message_types={"Pose"}), read(topics=set()), read(topics={"/pose"})
print("message_types={'Pose'}:", sorted(by_type))
print("topics=set():", sorted(by_nothing))
print("/pose alone:", alone["/pose"], "; beside others:", by_nothing["/pose"])
as_described = (
    sorted(by_type) == ["/note", "/pose"]
    and sorted(by_nothing) == ["/note", "/pose", "/temp"]
    and alone["/pose"] == {"x": 0}
    and isinstance(alone["/pose"]["x"], int)
    and by_nothing["/pose"] == {"x": 0, "celsius": None, "text": None}
    and isinstance(by_nothing["/pose"]["x"], float)
)
ray.shutdown()
sys.exit(0 if as_described else 1)
PYTHON
export RAY_USAGE_STATS_ENABLED=0 RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0 RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO=0
"$folder/venv/bin/python" -W ignore read.py "$folder/ray" 2> "$folder/said" || { cat "$folder/said" >&2; exit 1; }
