#!/usr/bin/env bash
# DVC 3.67.1: 'dvc exp run -S' writes all lists and texts of params.yaml anew, also those that it was not asked to change.
#
# 'dvc exp run -S train.epochs=5' is documented to change the value of a param. The file is edited by a round-trip YAML
# parser, so that comments and layout should stay; but lists and texts, not the changed value alone, are replaced by plain copies
# of themselves. Mappings are merged in place and keep their layout; a list loses the comments inside of it and its one-line
# form, a text its kind of quotes, null becomes an empty value. A number keeps its notation (1e-3), and inside of a one-line
# mapping a list stays on its line. In a repository the diff of one changed number is then as long as there are lists in
# the file, and comments are gone for good.
#
# Seen (dvc 3.67.1, Python 3.11): a comment inside a list is lost, [128, 128] is written as two lines, "0123" as
# '0123', null as nothing; a comment beside a mapping's key, 1e-3 and {sizes: [8, 8]} stay.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export DVC_NO_ANALYTICS=1 DO_NOT_TRACK=1
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check 'dvc==3.67.1'
export PATH="$folder/venv/bin:$PATH"

mkdir "$folder/work" && cd "$folder/work"
git init --quiet && git config user.name finding && git config user.email finding@example.org
dvc init --quiet
dvc config core.analytics false
cat > params.yaml <<'YAML'
train:
  epochs: 1 # how often
other:
  hidden: [128, 128]
  rate: 1e-3
  code: "0123"
  nothing: null
  flow: {sizes: [8, 8]}
  steps:
    - fill # the tank first
    - drain
YAML
cat > dvc.yaml <<'YAML'
stages:
  show:
    cmd: cp params.yaml seen
    params: [train.epochs]
    outs: [seen]
YAML
git add --all && git commit --quiet --message start
dvc exp run --quiet -S train.epochs=5 > /dev/null 2>&1
cat params.yaml

gone() {
    if grep --quiet "$1" params.yaml; then
        echo "still there: $1" >&2
        exit 1
    fi
}
grep --quiet 'epochs: 5 # how often' params.yaml
grep --quiet 'flow: {sizes: \[8, 8\]}' params.yaml
gone '\[128, 128\]'
grep --quiet 'rate: 1e-3' params.yaml
gone '"0123"'
gone 'null'
gone 'the tank first'
test "$(git diff --numstat params.yaml | cut -f 2)" -ge 6
