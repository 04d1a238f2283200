# make run: everything from an empty machine to the report.  make help: the other targets.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
JOBS ?= 2
# So many experiments run at the same time: with one for each core, the last one would run alone.
EXPERIMENTS ?= 3

# Half of the bytes are in a few packages; installed beside the others they halve the time.
LARGE := ^(mlflow|pandas|pyarrow|scikit-learn|scipy|sympy|torch)==
# The lock is complete, so nothing is resolved; what is imported is compiled then, not all 60,000 files now.
LOCKED := --no-deps --no-compile --no-build-isolation

export DO_NOT_TRACK := true
export DVC_NO_ANALYTICS := true
export MLFLOW_DISABLE_TELEMETRY := true
# Compiled once, torch and MLflow are imported in a quarter of the time; every stage and worker imports them.
unexport PYTHONDONTWRITEBYTECODE

.DEFAULT_GOAL := help
.PHONY: help setup run example ride hopper test test-cluster wheel test-wheel docs results ui bench clean

help:
	@echo "make run     install into $(VENV), run the pipeline, write data/reports/*/report.html"
	@echo "make example make logs of a pendulum in three formats and go from them to a report (two minutes)"
	@echo "make ride    fetch a real bicycle ride and go from it to a report (two minutes)"
	@echo "make hopper  install MuJoCo, record its Hopper and go from it to a report (ten minutes)"
	@echo "make test    check format, style, types and imports, then run the tests"
	@echo "make test-cluster  install Ray, then run the tests that need it, on two nodes of this machine"
	@echo "make wheel   build dist/addressed_dynamics-*.whl, to be installed anywhere"
	@echo "make test-wheel  build it, install it in an empty environment, and use it there"
	@echo "make docs    build the documentation in site/"
	@echo "make results fill README.md and docs/results.md with the figures of the last run (FROM=folder: of a run there)"
	@echo "make ui      browse the runs in MLflow (Ctrl-C ends it)"
	@echo "make bench   measure every speed claim, one after the other"
	@echo "make clean   remove what is not in Git: data, caches, runs and $(VENV)"

setup: $(VENV)/installed

# The stamp is written last: an interrupted installation starts again.
$(VENV)/locked: requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	    { echo "error: Python 3.11 or newer is needed; name one with 'make PYTHON=python3.12 …'" >&2; exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(PIP) install 'pip>=25' $$(grep '^setuptools==' requirements.lock)
	@grep -E  '$(LARGE)' requirements.lock > $(VENV)/large.txt
	@grep -vE '$(LARGE)' requirements.lock > $(VENV)/small.txt
	@echo "installing $$(grep -c == requirements.lock) packages, which takes a minute or two"
	@printf '%s\n' large small | xargs -P 2 -I '{}' $(PIP) install $(LOCKED) -r '$(VENV)/{}.txt'
	@# Adds what a lock made elsewhere cannot know, for instance the libraries of a torch built for a GPU.
	$(PIP) install --no-compile --no-build-isolation -r requirements.lock
	@touch $@

$(VENV)/installed: $(VENV)/locked pyproject.toml
	$(PIP) install --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/checked: $(VENV)/installed requirements-dev.lock
	@echo "installing $$(grep -c == requirements-dev.lock) packages more, which checks and tests need"
	$(PIP) install $(LOCKED) -r requirements-dev.lock
	@touch $@

run: $(VENV)/installed
	@git rev-parse --git-dir > /dev/null 2>&1 || { echo "error: DVC keeps its records in Git, and this folder is not a \
	Git repository; clone it, or run 'git init' in it first" >&2; exit 1; }
	@# What a DVC that was killed left half written stops every later one until it is removed (docs/soak.md).
	@find .dvc/cache/runs -type d -empty -delete 2> /dev/null; find .dvc/tmp/rwlock -size 0 -delete 2> /dev/null; true
	@# The experiments side by side: DVC runs the stages of one 'dvc repro' in turn, and most keep one core busy. Each waits for the others' locks, which last seconds.
	@# Of more than there are cores, the later ones give way a little: at the end of each, a stage keeps one core alone.
	@PATH="$(CURDIR)/$(BIN):$$PATH"; dvc status --quiet || \
	    dvc stage list --name-only | grep '^report@' | awk '{ print (NR > $(JOBS) ? 4 : 0), $$0 }' | \
	    xargs -P $(EXPERIMENTS) -L 1 sh -c 'exec nice -n "$$0" dvc --wait-for-lock repro "$$1"'
	@$(BIN)/addressed-dynamics verdicts

# The example is added to what the pipeline runs: named alone, it would take the other experiments' data out of the folder.
example: $(VENV)/installed
	$(BIN)/python examples/pendulum/make_logs.py
	@PATH="$(CURDIR)/$(BIN):$$PATH" dvc exp run report@pendulum -S '++imported.pendulum=examples/pendulum/logs' \
	    -S '++experiments.pendulum={kind: transitions, raw: data/raw/pendulum}'

ride: $(VENV)/installed
	$(BIN)/python examples/ride/make_table.py
	@grep -q '^ride:' params.yaml || $(BIN)/addressed-dynamics new ride examples/ride/logs --yes \
	    --observation 'speed [m/s]' --observation 'heart_rate [1/min]' \
	    --action 'power [W]' --action 'cadence [1/min]' --exogenous slope
	@PATH="$(CURDIR)/$(BIN):$$PATH" dvc repro report@ride

$(VENV)/mujoco: $(VENV)/installed
	$(PIP) install --no-compile --no-build-isolation --constraint requirements.lock --editable '.[mujoco]'
	@touch $@

# As the pendulum, it is added to what the pipeline runs.
hopper: $(VENV)/mujoco
	@PATH="$(CURDIR)/$(BIN):$$PATH" dvc exp run report@hopper -S '++recorded.hopper=transitions' \
	    -S '++experiments.hopper={kind: transitions, raw: data/raw/hopper}'

test: $(VENV)/checked
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	PATH="$(CURDIR)/$(BIN):$$PATH" OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder \
	    --ignore tests/cluster

$(VENV)/cluster: $(VENV)/checked requirements-cluster.lock
	$(PIP) install $(LOCKED) -r requirements-cluster.lock
	@touch $@

test-cluster: $(VENV)/cluster
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/cluster

# What an earlier build left in build/ would be in the wheel, too.
wheel: $(VENV)/installed
	rm -rf build dist
	$(PIP) wheel --no-deps --no-build-isolation --wheel-dir dist .
	@ls dist/*.whl

test-wheel: wheel $(VENV)/checked
	OMP_NUM_THREADS=1 PYTHONPATH=tests $(BIN)/python tests/installing.py dist/*.whl

# The banner that the variable turns off says what its makers sell next.
docs: $(VENV)/checked
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "open site/index.html"

# A run of another scale, in a clone of its own: make results FROM=path/to/clone
FROM ?= .
results: $(VENV)/installed
	$(BIN)/python -m publishing --from '$(FROM)'

ui: $(VENV)/installed
	$(BIN)/addressed-dynamics ui

bench: $(VENV)/installed
	@set -e; for script in $$(grep -l "def main" benchmarks/*.py | grep -vE "larger_than_memory|real_data|whole_run|soak"); do echo "== $$script"; $(BIN)/python "$$script"; done

clean:
	rm -rf $(VENV) build dist site .checkpoints .mlflow .dvc/cache .dvc/tmp data
	rm -rf .hypothesis .import_linter_cache .mypy_cache .pytest_cache .ruff_cache src/*.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
