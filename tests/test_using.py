"""What docs/simulator.md shows of environments runs as it stands there."""

import re
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from builders import CAR
from driven import motion_model
from trusted_models import write_mountaincar

from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.policies.policy import Policy, save_policy
from addressed_dynamics.simulators.starts import write_starts

USING = Path(__file__).parents[1] / "docs" / "simulator.md"


def programs(title: str) -> list[str]:
    """The Python in a section."""
    section = USING.read_text(encoding="utf-8").split(f"## {title}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of models of a car, at the place where the pipeline has that of MountainCar."""
    folder, train = write_mountaincar(tmp_path)
    write_starts(folder, starts_of(train, 1))
    monkeypatch.chdir(tmp_path)
    return folder


def test_the_environments_of_the_documentation_run(models: Path) -> None:
    alone, together, _ = programs("A model as an environment")
    assert together.count("200_000") == 1
    assert models.is_dir()
    names: dict[str, Any] = {}
    exec(alone, names)
    assert names["info"]["clipped"] is False
    np.testing.assert_array_equal(names["state"], np.float32([-0.5, 0.0]))
    assert (names["reward"], names["terminated"]) == (-1.0, False)
    exec(together.replace("200_000", "1"), names)
    assert names["agent"].num_timesteps == 64 * 32


def test_the_environment_of_motion_of_the_documentation_walks() -> None:
    *_, walking = programs("A model as an environment")
    names: dict[str, Any] = {"gymnasium": gymnasium, "model": motion_model(), "my_reward": None}
    exec(walking.replace('"data/models/pfnn"', "model"), names)
    assert not names["terminated"]
    assert names["info"]["stopped_by"] in ("", "flown_off")


def test_the_policy_of_the_documentation_drives_the_true_car(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "data" / "policies" / "mountaincar"
    folder.mkdir(parents=True)
    # It pushes in the direction of motion, and so swings up.
    layers = ((np.float32([[0.0, -1.0], [0.0, 0.0], [0.0, 1.0]]), np.float32([0.0, -1.0, 0.0])),)
    save_policy(folder, Policy(CAR, 2, np.zeros(2, np.float32), np.float32([1.0, 0.07]), layers))
    (program,) = programs("A policy that was learned in it")
    names: dict[str, Any] = {}
    exec(program, names)
    assert names["terminated"]
    assert names["state"][0] >= 0.5
