#!/usr/bin/env bash
# ray 2.60.0: a node that is started at 127.0.0.1 is not at 127.0.0.1.
#
# ray.init(_node_ip_address="127.0.0.1") names the address at which a node of one machine should be, and Ray takes it without a
# word, but puts in its place the address that the machine has in its network. What does keep a node on the loopback is a variable
# that speaks of other systems, RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0, which is 0 by default on macOS and Windows alone; then no
# address has to be given at all.
#
# Seen (ray 2.60.0, Linux, Python 3.11): as above. This script exits with 0 as long as that is so, with 1 when it changes, and with
# 2 on a machine that has no address but the loopback's.
set -euo pipefail

[[ -n "$(hostname -I 2> /dev/null | tr -d ' ')" ]] || { echo "this machine has no other address"; exit 2; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check ray==2.60.0

cd "$folder"
cat > address.py <<'PYTHON'
import sys

import ray

given = {} if sys.argv[1] == "none" else {"_node_ip_address": sys.argv[1]}
ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False, logging_level="ERROR", _temp_dir=sys.argv[2], **given)
print(ray.nodes()[0]["NodeManagerAddress"])
ray.shutdown()
PYTHON
export RAY_USAGE_STATS_ENABLED=0 RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO=0
asked=$("$folder/venv/bin/python" -W ignore address.py 127.0.0.1 "$folder/a" 2> /dev/null | tail -1)
variable=$(RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER=0 "$folder/venv/bin/python" -W ignore address.py none "$folder/b" 2> /dev/null | tail -1)
echo "asked for 127.0.0.1: $([[ $asked == 127.0.0.1 ]] && echo "there" || echo "at the machine's other address")"
echo "with the variable for other systems, asked for nothing: $variable"
[[ -n $asked && $asked != 127.0.0.1 && $variable == 127.0.0.1 ]]
