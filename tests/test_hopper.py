"""The example with contacts, as far as it goes without MuJoCo."""

from pathlib import Path
from typing import ClassVar

import gymnasium
import numpy as np
import pytest
from dvc_settings import apply_overrides
from example_command import overrides
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from ruamel.yaml import YAML

from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.base.params.recording import GaitBehaviour
from addressed_dynamics.recording.gait import GaitPolicy
from addressed_dynamics.recording.spaces import space_spec

ROOT = Path(__file__).parents[1]


class Hopper(gymnasium.Env):
    """What of MuJoCo's Hopper there is without MuJoCo."""

    metadata: ClassVar = {"render_fps": 125}
    observation_space = spaces.Box(-np.inf, np.inf, (11,), dtype=np.float64)
    action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)

    def __init__(self, name: str) -> None:
        self.spec = EnvSpec(name, entry_point="")


@pytest.mark.parametrize("name", ["Hopper-v4", "Hopper-v5"])
def test_the_dimensions_of_the_hopper_have_names_and_units(name: str) -> None:
    spec = space_spec(Hopper(name))
    assert spec.step_seconds == 0.008
    assert [each.name for each in spec.observation[:2]] == ["height", "torso_angle"]
    units = {each.name: each.unit for each in spec.observation}
    assert (units["foot_angle"], units["forward_velocity"], units["foot_velocity"]) == ("rad", "m/s", "rad/s")
    assert [each.name for each in spec.action.dimensions] == ["thigh_torque", "leg_torque", "foot_torque"]


def test_the_gaits_of_the_example_fit_the_hopper_and_it_records_200_000_transitions() -> None:
    params = load_experiment(ROOT / "params.yaml", "hopper", "transitions")
    assert sum(segment.transitions for segment in params.record.segments) == 200_000
    hopper, generator = Hopper("Hopper-v5"), np.random.default_rng(0)
    gaits = [segment.behaviour for segment in params.record.segments if isinstance(segment.behaviour, GaitBehaviour)]
    assert len(gaits) == 2
    for gait in gaits:
        actions = GaitPolicy(gait, space_spec(hopper), hopper.action_space, 4, generator)(np.zeros((4, 11)))
        assert np.abs(actions).max() > 0.01


def test_the_pipeline_leaves_the_example_alone_until_its_command_adds_it(tmp_path: Path) -> None:
    before = (ROOT / "params.yaml").read_text(encoding="utf-8")
    document = YAML(typ="safe", pure=True).load(before)
    assert not {"hopper"} & (document["experiments"].keys() | document["recorded"].keys())
    settings = overrides(ROOT / "Makefile", "hopper")
    assert settings == overrides(ROOT / "examples" / "hopper" / "README.md", "hopper")
    changed = tmp_path / "params.yaml"
    changed.write_text(before, encoding="utf-8")
    apply_overrides(changed, settings)
    document = YAML(typ="safe", pure=True).load(changed.read_text(encoding="utf-8"))
    assert document["experiments"]["hopper"] == {"kind": "transitions", "raw": "data/raw/hopper"}
    assert document["recorded"]["hopper"] == "transitions"
