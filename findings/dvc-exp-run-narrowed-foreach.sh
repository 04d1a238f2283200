#!/usr/bin/env bash
# DVC 3.67.1: 'dvc exp run' on a narrowed foreach takes the outputs of the other stages out of the workspace.
#
# A pipeline has one stage for each entry of a list in params.yaml, and both have run. 'dvc exp run -S' with a list of
# one entry, which reads as "run only this one", runs that one and then applies the experiment to the workspace: the output
# of the stage that the narrowed list no longer makes is deleted, although nothing that was run had to do with it. The
# command says that its results "have been applied to your workspace" and exits with 0; 'git checkout' of params.yaml and
# dvc.lock does not bring the file back, 'dvc checkout' does. A plain 'dvc repro' of the one stage, and 'dvc exp run' with
# the stage as its target, leave the other output where it is.
#
# Seen (dvc 3.67.1, Python 3.11): after the narrowed run out/a is there and out/b is not.
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
printf 'parts: [a, b]\nvalue: 1\n' > params.yaml
cat > dvc.yaml <<'YAML'
stages:
  make:
    foreach: ${parts}
    do:
      cmd: mkdir -p out && echo ${value} > out/${item}
      outs:
        - out/${item}
YAML
dvc repro --quiet
git add --all && git commit --quiet --message start
test -f out/a && test -f out/b

# With a target, nothing is lost …
dvc exp run --quiet -S value=3 make@a
targeted="$(ls out | tr '\n' ' ')"
# … with a narrowed list, the other output is.
dvc exp run --quiet -S value=4 -S 'parts=[a]'
narrowed="$(ls out | tr '\n' ' ')"
git checkout --quiet -- params.yaml dvc.lock
after_git="$(ls out | tr '\n' ' ')"
dvc checkout --quiet
after_dvc="$(ls out | tr '\n' ' ')"
echo "with a target: $targeted| narrowed: $narrowed| after git checkout: $after_git| after dvc checkout: $after_dvc"
[ "$targeted" = "a b " ] && [ "$narrowed" = "a " ] && [ "$after_git" = "a " ] && [ "$after_dvc" = "a b " ]
