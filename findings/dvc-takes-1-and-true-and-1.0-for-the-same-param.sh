#!/usr/bin/env bash
# DVC 3.67.1: a param that changes from 1 to 1.0, or from 1 to true, has not changed: the stage is up to date, the old result stays.
#
# Many libraries give the two kinds of number two meanings: in scikit-learn, min_samples_leaf=1 is one sample and 1.0 is all of them,
# test_size=1 one row and 1.0 the whole table; a key may be a flag or a count ('warmup: true', 'warmup: 1'). DVC compares params as
# Python does, where 1 == 1.0 == True, while the stage sees what stands in the file. 'dvc status' and 'dvc params diff' say nothing, and
# 'dvc repro' keeps what was made with the other. Only '--force' runs it, and then the result differs with no param to say why.
#
# Seen (dvc 3.67.1, Python 3.11): after 1 became 1.0, and after 1 became true, up to date, no difference, result of 1; after 2, it runs.
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
cat > stage.py <<'PYTHON'
import yaml

held_out = yaml.safe_load(open("params.yaml"))["held_out"]
rows = held_out if type(held_out) is int else round(200 * held_out)
open("seen", "w").write(f"{rows} rows of 200\n")
PYTHON
cat > dvc.yaml <<'YAML'
stages:
  split:
    cmd: python stage.py
    params: [held_out]
    outs: [seen]
YAML
echo 'held_out: 1' > params.yaml
dvc repro --quiet && git add --all && git commit --quiet --message run

for value in 1.0 true; do
    echo "held_out: $value" > params.yaml
    status=$(dvc status) difference=$(dvc params diff)
    dvc repro --quiet
    echo "held_out: $value: status '$status', params diff '$difference', result '$(cat seen)'"
    [ "$status" = 'Data and pipelines are up to date.' ] && [ -z "$difference" ] && [ "$(cat seen)" = '1 rows of 200' ]
done
echo 'held_out: 1.0' > params.yaml
dvc repro --quiet --force
echo "forced: result '$(cat seen)'"
[ "$(cat seen)" = '200 rows of 200' ]
echo 'held_out: 2' > params.yaml
dvc repro --quiet
[ "$(cat seen)" = '2 rows of 200' ]
