"""The example that ships with the project: from three foreign logs to a report, as README.md beside it says."""

import hashlib
import os
import subprocess
from pathlib import Path

import pytest
from dvc_settings import apply_overrides
from example_command import overrides
from pipeline_clones import warm_interpreter
from ruamel.yaml import YAML

from addressed_dynamics.base.params.experiments import load_experiment

ROOT = Path(__file__).parents[1]
EXAMPLE = ROOT / "examples" / "pendulum"
ENVIRONMENT = os.environ | {
    "PYTHONPATH": f"{ROOT}{os.pathsep}{ROOT / 'src'}",
    "OMP_NUM_THREADS": "1",
    "ADDRESSED_DYNAMICS_PROCESSES": "1",
}


def run(folder: Path, *arguments: str) -> None:
    done = subprocess.run(
        [warm_interpreter() / "python", *arguments],
        cwd=folder,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def make_logs(folder: Path, *, seed: int = 0) -> dict[str, str]:
    """Write short logs; return the hash of each."""
    script = str(EXAMPLE / "make_logs.py")
    run(ROOT, script, "--out", str(folder), "--episodes", "4", "--seconds", "6", "--seed", str(seed))
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(folder.iterdir())}


def test_the_params_of_the_example_are_params_of_one_that_is_imported() -> None:
    params = load_experiment(ROOT / "params.yaml", "pendulum", "transitions")
    assert params.record is None
    assert params.source.files == ("examples/pendulum/logs/*.mcap",)


def test_the_command_for_the_example_adds_it_to_what_the_pipeline_runs(tmp_path: Path) -> None:
    settings = overrides(ROOT / "Makefile")
    assert settings == overrides(EXAMPLE / "README.md")
    before = (ROOT / "params.yaml").read_text(encoding="utf-8")
    changed = tmp_path / "params.yaml"
    changed.write_text(before, encoding="utf-8")
    for _ in range(2):  # it may be run again
        apply_overrides(changed, settings)
        document = YAML(typ="safe", pure=True).load(changed.read_text(encoding="utf-8"))
        assert document["experiments"]["pendulum"] == {"kind": "transitions", "raw": "data/raw/pendulum"}
        assert document["imported"] == {"pendulum": "examples/pendulum/logs"}
        lines = changed.read_text(encoding="utf-8").splitlines()
        assert len(set(before.splitlines()) - set(lines)) == 1, "the line of `imported`, and no other"


@pytest.mark.slow
def test_the_same_seed_makes_the_same_logs_and_another_makes_others(tmp_path: Path) -> None:
    first = make_logs(tmp_path / "first")
    assert list(first) == ["json.mcap", "protobuf.mcap", "ros2.mcap"]
    assert make_logs(tmp_path / "again") == first
    assert not set(make_logs(tmp_path / "other", seed=1).values()) & set(first.values())
