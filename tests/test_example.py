"""The example that ships with the project: from three foreign logs to a report, as README.md beside it says."""

import hashlib
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest
from dvc_settings import apply_overrides
from example_command import overrides
from pipeline_clones import warm_interpreter
from ruamel.yaml import YAML

from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.episodes.transitions import Transitions
from examples.pendulum.longer_arm import arm_transitions
from examples.pendulum.make_logs import integrate

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


@pytest.mark.parametrize("length", [0.5, 0.7, 1.0])
def test_an_arm_of_any_length_moves_by_its_own_equation(length: float) -> None:
    torque, start = np.full((500, 3), [-1.0, 0.5, 2.0]), np.array([1.0, -0.5, 2.0])
    states = integrate(torque, start, length)
    angle, speed = (states[1:, place] + states[:-1, place] for place in (0, 1))
    middle = angle / 2, speed / 2
    friction = 0.4 * middle[1] + 0.1 * np.tanh(middle[1] / 0.05)
    expected = (torque - friction - 9.81 * length * np.sin(middle[0])) / length**2
    np.testing.assert_allclose(np.diff(states[:, 1], axis=0) / 0.001, expected, atol=5e-3)
    same = np.array_equal(integrate(torque, start), states)
    assert same == (length == 0.5), "the example's arm has 0.5 m"


def test_transitions_of_a_longer_arm_have_the_spaces_of_the_example_and_other_mechanics(tmp_path: Path) -> None:
    found = {}
    for length in (0.5, 0.8):
        (folder := tmp_path / str(length)).mkdir()
        found[length] = arm_transitions(length, folder, episodes=1, seconds=6.0)
    usual, longer = found.values()
    assert usual.spec == longer.spec
    assert usual.spec.observation_names == ("angle", "speed")
    assert len(usual) == len(longer) > 200

    def pull(transitions: Transitions) -> float:
        """The weight of the angle in the acceleration: gravity over the length of the arm, in 1/s²."""
        known = np.column_stack([transitions.observation, transitions.action])
        change = (transitions.next_observation - transitions.observation)[:, 1] / transitions.spec.step_seconds
        return -float(np.linalg.lstsq(known, change, rcond=None)[0][0])

    assert pull(longer) < 0.8 * pull(usual)


@pytest.mark.slow
def test_the_same_seed_makes_the_same_logs_and_another_makes_others(tmp_path: Path) -> None:
    first = make_logs(tmp_path / "first")
    assert list(first) == ["json.mcap", "protobuf.mcap", "ros2.mcap"]
    assert make_logs(tmp_path / "again") == first
    assert not set(make_logs(tmp_path / "other", seed=1).values()) & set(first.values())
