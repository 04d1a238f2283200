import json
from dataclasses import replace
from pathlib import Path

import pytest
from learning import drive
from trusted_models import drifting, write_models
from typer.testing import CliRunner

from addressed_dynamics.base.errors import AddressedDynamicsError
from addressed_dynamics.cli.judging_logs import judge_logs
from addressed_dynamics.cli.main import app
from addressed_dynamics.logs import write_log


@pytest.fixture
def models(tmp_path: Path) -> Path:
    return write_models(tmp_path / "models")


def test_logs_like_the_training_data_and_logs_of_another_machine(models: Path, tmp_path: Path) -> None:
    for name, gain in (("same", 0.5), ("stronger", 1.5)):
        write_log(tmp_path / f"{name}.mcap", drifting(10, 21, gain=gain))
    same, other = (judge_logs(models, tmp_path / f"{name}.mcap", "total_parameters") for name in ("same", "stronger"))
    assert [each.steps for each in same] == [40] * 10
    assert sum(each.surprise for each in same) / 10 == pytest.approx(1.0, abs=0.2)
    assert sum(each.trust for each in same) / 10 == pytest.approx(0.5, abs=0.15)
    assert min(each.surprise for each in other) > max(each.surprise for each in same)


def test_the_command_shows_the_most_surprising_episodes_first(models: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    write_log(log, drifting(3, 21))
    arguments = ["trust", str(models), str(log), "--candidate", "total_parameters"]
    shown = CliRunner().invoke(app, arguments)
    assert shown.exit_code == 0
    assert "all 3" in shown.output
    assert "trust is 0.5 and surprise 1 on average" in " ".join(shown.output.split())
    document = json.loads(CliRunner().invoke(app, [*arguments, "--json"]).output)
    assert [each["episode"] for each in document["episodes"]] == [0, 1, 2]


def test_logs_in_other_units_or_at_another_rate_are_refused(models: Path, tmp_path: Path) -> None:
    same = drifting(3, 21)
    first, *others = same.spec.observation
    changes = {
        "in m, but in mm in these logs": replace(same.spec, observation=(replace(first, unit="mm"), *others)),
        r"step takes 0\.1 s, but 0\.2 s in these logs": replace(same.spec, step_seconds=0.2),
    }
    for number, (what, spec) in enumerate(changes.items()):
        write_log(tmp_path / f"{number}.mcap", replace(same, spec=spec))
        with pytest.raises(AddressedDynamicsError, match=what):
            judge_logs(models, tmp_path / f"{number}.mcap", "total_parameters")
    bare = replace(same.spec, observation=(replace(first, unit=""), *others))
    write_log(tmp_path / "bare.mcap", replace(same, spec=bare))
    assert len(judge_logs(models, tmp_path / "bare.mcap", "total_parameters")) == 3


def test_logs_of_another_world_are_refused(models: Path, tmp_path: Path) -> None:
    write_log(tmp_path / "car.mcap", drive((10,)))
    with pytest.raises(AddressedDynamicsError, match=r"car\.mcap: the model's states are .*position.*speed"):
        judge_logs(models, tmp_path / "car.mcap", "total_parameters")
