#!/usr/bin/env bash
# DVC 3.67.1 and PyYAML 6.0.3: 'dvc exp run -S rate=0.00001' gives a stage that reads its params with PyYAML the text '1e-05'.
#
# DVC reads and writes YAML 1.2, in which 1e-05 is a number; PyYAML reads YAML 1.1, in which a float needs a point. A rate is set on the
# command line as 0.00001, 1e-5 or 1.0e-5: DVC writes '1e-05' each time, shows a number in 'dvc params diff' and in the experiment's table,
# and the stage gets a text, which fails far from there or is compared and formatted as one. 0.0001 is written with its point, so a sweep
# over rates breaks at its small end.
#
# Seen (dvc 3.67.1, PyYAML 6.0.3, Python 3.11): rates 0.0001, 0.00001 and 1.0e-5 arrive as float, str and str.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export DVC_NO_ANALYTICS=1 DO_NOT_TRACK=1
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dvc==3.67.1 PyYAML==6.0.3
export PATH="$folder/venv/bin:$PATH"

mkdir "$folder/work" && cd "$folder/work"
git init --quiet && git config user.name finding && git config user.email finding@example.org
dvc init --quiet
echo 'rate: 0.001' > params.yaml
cat > stage.py <<'PYTHON'
import yaml

rate = yaml.safe_load(open("params.yaml"))["rate"]
open("seen", "w").write(f"{type(rate).__name__} {rate}\n")
PYTHON
cat > dvc.yaml <<'YAML'
stages:
  train:
    cmd: python stage.py
    params: [rate]
    outs: [seen]
YAML
git add --all && git commit --quiet --message start
dvc repro --quiet && git add --all && git commit --quiet --message run

found=''
for rate in 0.0001 0.00001 1.0e-5; do
    dvc exp run --quiet -S rate=$rate > /dev/null 2>&1
    echo "-S rate=$rate: params.yaml has '$(cat params.yaml)', the stage gets $(cat seen)"
    dvc params diff
    found="$found$(cut -d ' ' -f 1 seen) "
done
[ "$found" = 'float str str ' ]
