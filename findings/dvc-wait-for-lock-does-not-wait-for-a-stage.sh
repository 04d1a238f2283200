#!/usr/bin/env bash
# `dvc --wait-for-lock repro` does not wait while another process runs the same stage: it ends at once with an error. The
# same command without the option ends with the same error, and a stage beside it runs at the same time in both.
#
# Versions: Python 3.11, DVC 3.67.1.
#
# Behaviour: the option is about the lock of the repository, which DVC holds for parts of a second around a command and
# gives back while a stage's own command runs. What is then locked are the paths that the stage reads and writes
# (.dvc/tmp/rwlock), and for these DVC never waits, whatever the option.
#
# Output seen (first line of each error, the project's folder taken out):
#   the same stage, waiting: status 255, ERROR: failed to reproduce 'slow': 'out' is busy, it is being blocked by:
#   the same stage, not waiting: status 255, ERROR: failed to reproduce 'slow': 'out' is busy, it is being blocked by:
#   another stage, waiting: status 0, done while the first runs
#   the first: status 0
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check dvc==3.67.1
export PATH="$folder/venv/bin:$PATH" DVC_NO_ANALYTICS=true DVC_GLOBAL_CONFIG_DIR="$folder/config" DVC_SITE_CACHE_DIR="$folder/site"
mkdir "$folder/project"
cd "$folder/project"
git init --quiet
dvc init --quiet
dvc config core.check_update false
cat > dvc.yaml <<'YAML'
stages:
  slow:
    cmd: touch started; sleep 20; echo slow > out
    outs: [out]
  quick:
    cmd: echo quick > other
    outs: [other]
YAML
dvc repro --quiet slow > first.log 2>&1 &
first=$!
until [ -e started ]; do sleep 0.2; done
tell() {
    local status=0
    "${@:2}" > said.log 2>&1 || status=$?
    echo "$1: status $status$(grep -a ERROR said.log | head -n 1 | sed "s#$folder/project/##; s/^/, /")"
}
{
    tell "the same stage, waiting" dvc --wait-for-lock repro slow
    tell "the same stage, not waiting" dvc repro slow
    tell "another stage, waiting" dvc --wait-for-lock repro quick | tr -d '\n'
    [ -e out ] || echo ", done while the first runs"
    status=0
    wait "$first" || status=$?
    echo "the first: status $status"
} > seen
cat seen
diff seen - <<'EXPECTED'
the same stage, waiting: status 255, ERROR: failed to reproduce 'slow': 'out' is busy, it is being blocked by:
the same stage, not waiting: status 255, ERROR: failed to reproduce 'slow': 'out' is busy, it is being blocked by:
another stage, waiting: status 0, done while the first runs
the first: status 0
EXPECTED
echo "as described"
