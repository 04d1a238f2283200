#!/usr/bin/env bash
# DVC 3.67.1: a folder of a web server is taken as a dependency, and a file in it that is replaced or renamed goes unnoticed.
#
# 'deps: [https://host/runs/]' is accepted like 's3://bucket/runs', which DVC hashes file by file, and like a single file of a web server,
# of which it notices a change by what the server says. Of a folder dvc.lock keeps a checksum and a size as of a file: they are made
# of what the server says of the page that lists it, and with most servers that is the page's length. So a new name of another length is a change,
# and a file with other contents, or with another name of the same length, is none: 'Data and pipelines are up to date.'
#
# Seen (dvc 3.67.1 with dvc-http 2.32.0, Python 3.11): as above, against 'python -m http.server' on the loopback.
# This script exits with 0 as long as that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
export DVC_NO_ANALYTICS=1 DO_NOT_TRACK=1
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dvc==3.67.1 dvc-http==2.32.0
export PATH="$folder/venv/bin:$PATH"

mkdir -p "$folder/web/runs" "$folder/work"
echo first > "$folder/web/runs/run_1.csv"
python -u -m http.server 0 --bind 127.0.0.1 --directory "$folder/web" > "$folder/said" 2> /dev/null &
server=$!
trap 'kill $server; rm -rf "$folder"' EXIT
until port=$(grep --only-matching --extended-regexp 'port [0-9]+' "$folder/said"); do sleep 0.2; done
runs="http://127.0.0.1:${port#port }/runs/"

cd "$folder/work"
git init --quiet
dvc init --quiet
state() {
    printf 'stages:\n  use:\n    cmd: echo used\n    deps: ["%s"]\n' "$1" > dvc.yaml
    dvc status --quiet && echo 'up to date' || echo 'changed'
}
for of in "$runs" "${runs}run_1.csv"; do
    echo first > "$folder/web/runs/run_1.csv"
    rm -f dvc.lock
    state "$of" > /dev/null
    dvc repro --quiet > /dev/null
    [ "$(state "$of")" = 'up to date' ]
    sleep 1.1 # servers say when a file changed in whole seconds
    echo 'another run, and a longer one' > "$folder/web/runs/run_1.csv"
    echo "${of##*127.0.0.1:*/runs/}: run_1.csv replaced: $(state "$of")"
    replaced+=("$(state "$of")")
done
rm -f dvc.lock
state "$runs" > /dev/null
dvc repro --quiet > /dev/null
mv "$folder/web/runs/run_1.csv" "$folder/web/runs/run_2.csv"
renamed=$(state "$runs")
echo one more > "$folder/web/runs/run_10.csv"
added=$(state "$runs")
echo "of the folder: run_1.csv renamed to run_2.csv: $renamed; run_10.csv added: $added"
[ "${replaced[*]}" = 'up to date changed' ] && [ "$renamed" = 'up to date' ] && [ "$added" = 'changed' ]
