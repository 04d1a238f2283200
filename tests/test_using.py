"""What docs/simulator.md shows of environments runs as it stands there."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from learning import drive
from trusted_models import linear_model, write_pair

from addressed_dynamics.evaluation.transitions.calibration import calibrate
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.starting import starts_of
from addressed_dynamics.features.transitions.spec import fit_features
from addressed_dynamics.simulators.delivery import Delivered, write_delivered
from addressed_dynamics.simulators.starts import write_starts
from addressed_dynamics.sources.transitions.params import FeatureParams

USING = Path(__file__).parents[1] / "docs" / "simulator.md"


def programs(title: str) -> list[str]:
    """The Python in a section."""
    section = USING.read_text(encoding="utf-8").split(f"## {title}\n")[1].split("\n## ")[0]
    return re.findall(r"```python\n(.*?)```", section, flags=re.DOTALL)


@pytest.fixture
def models(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of models of a car, at the place where the pipeline has that of MountainCar."""
    train, validation = drive((30,) * 12), drive((30,) * 8, seed=1)
    features = fit_features(train, FeatureParams())
    half = train.episode < 6
    model, partner = linear_model(features, train.select(half)), linear_model(features, train.select(~half))
    trust = calibrate(model, partner, Points.of(train, features), Points.of(validation, features), steps=10)
    folder = write_pair(tmp_path / "data" / "models" / "mountaincar", model, partner, trust)
    write_delivered(folder, Delivered(0, None, "argmax", candidate="total_parameters"))
    write_starts(folder, starts_of(train, 1))
    monkeypatch.chdir(tmp_path)
    return folder


def test_the_environments_of_the_documentation_run(models: Path) -> None:
    alone, together = programs("A model as an environment")
    assert together.count("200_000") == 1
    assert models.is_dir()
    names: dict[str, Any] = {}
    exec(alone, names)
    assert names["info"]["clipped"] is False
    np.testing.assert_array_equal(names["state"], np.float32([-0.5, 0.0]))
    assert (names["reward"], names["terminated"]) == (-1.0, False)
    exec(together.replace("200_000", "1"), names)
    assert names["agent"].num_timesteps == 64 * 32
