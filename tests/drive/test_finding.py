"""What is meant by a name on the command line, and what is said of names that mean nothing."""

import json
from pathlib import Path

import pytest
from driven import write_drift
from trusted_models import write_models

from addressed_dynamics.base.errors import DriveError, ModelError, ParamsError
from addressed_dynamics.base.files import why_not_folder
from addressed_dynamics.base.params.recording import EnvironmentParams
from addressed_dynamics.cli import main as cli
from addressed_dynamics.cli.driving import drive_in_page
from addressed_dynamics.drive.finding import Named, environment_of, find, made
from addressed_dynamics.drive.transitions import DrivenWorld
from addressed_dynamics.envs import ACROBOT, CONTINUING_MOUNTAIN_CAR

WHICH = "total_parameters"
"""The candidate in the folders here: they name none that is delivered."""


def test_a_name_is_that_of_an_experiment_with_models_or_a_folder(tmp_path: Path) -> None:
    folder = write_drift(tmp_path / "models" / "drift")
    named = find("drift", None, WHICH, tmp_path / "models")
    assert named == Named(folder, "drift", "transitions")
    assert find(str(folder), None, WHICH) == named
    driven = DrivenWorld.load(named, WHICH)
    assert driven.calibrated is not None
    assert driven.environment is None


def test_the_params_of_an_experiment_name_its_environment(tmp_path: Path) -> None:
    repository = Path(__file__).parents[2]
    found = {}
    for name in ("mountaincar", "acrobot"):
        write_drift(tmp_path / name)
        named = find(name, repository / "params.yaml", WHICH, tmp_path)
        found[named.title] = named.environments[0].id
    assert found == {"MountainCar": CONTINUING_MOUNTAIN_CAR, "Acrobot": ACROBOT}
    assert named.environments[0].kwargs == {"time_step": 0.02}
    assert find(str(tmp_path / "acrobot"), repository / "params.yaml", WHICH) == named


def test_a_params_file_that_is_named_has_the_experiment(tmp_path: Path) -> None:
    write_drift(tmp_path / "pfnn")
    (tmp_path / "other.yaml").write_text("walk: {title: Walk}\n")
    for file, said in (
        (tmp_path / "none.yaml", "none.yaml: no such params file"),
        (Path(__file__).parents[2] / "params.yaml", "'pfnn' is of motion there, but .*pfnn is a model of transitions"),
        (tmp_path / "other.yaml", r"there is no experiment 'pfnn' in it \(experiments there: walk\)"),
    ):
        with pytest.raises(ParamsError, match=said):
            find("pfnn", file, WHICH, tmp_path)


def test_no_limit_of_time_ends_what_a_person_drives() -> None:
    limited = EnvironmentParams(id=ACROBOT, kwargs={"ends_at_goal": False, "max_episode_steps": 3})
    with made(limited) as environment:
        environment.reset(seed=0)
        assert not any(environment.step(1)[3] for _ in range(1100))


def test_nothing_of_that_name_is_said_with_what_there_is(tmp_path: Path) -> None:
    (tmp_path / "arm").mkdir()
    (tmp_path / "boat").mkdir()
    file = tmp_path / "params.yaml"
    file.write_text("experiments: {arm: {kind: transitions, raw: a}, car: {kind: transitions, raw: b}}\n")
    nothing = (
        r"neither an experiment 'plane' nor a folder of that name \(experiments of .*: arm, car; in .*: arm, boat\)"
    )
    with pytest.raises(DriveError, match=nothing):
        find("plane", file, None, tmp_path)
    with pytest.raises(DriveError, match="'car' has no models yet; 'dvc repro evaluate@car' makes them"):
        find("car", file, None, tmp_path)
    with pytest.raises(DriveError, match=r"in .*none: none\)"):
        find("plane", None, None, tmp_path / "none")


def test_recordings_that_could_not_be_written_are_refused_before_anything_else(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file" / "logs", Path("/proc/logs")):
        with pytest.raises(DriveError, match=f"^--record-to {folder}: it cannot be written .*; name another folder"):
            drive_in_page("x", None, port=0, candidate=None, environment=None, record_to=folder, seed=None)
    assert why_not_folder(tmp_path / "a" / "b") is None
    assert [each.name for each in tmp_path.iterdir()] == ["file"]


def test_a_model_folder_of_another_version_is_said_in_one_line(tmp_path: Path, capsys, monkeypatch) -> None:
    folder = write_drift(tmp_path / "drift")
    monkeypatch.setattr("sys.argv", ["addressed-dynamics", "drive", str(folder), "--candidate", WHICH])
    config = folder / "baselines" / WHICH / "seed-0" / "network" / "config.json"
    known = json.loads(config.read_text())
    older = {**known, "features": {key: value for key, value in known["features"].items() if key != "history"}}
    for changed, words in ((older, "first version of this package"), ({**known, "format": 2}, "format")):
        config.write_text(json.dumps(changed))
        with pytest.raises(SystemExit) as caught:
            cli.main()
        said = capsys.readouterr().err
        assert (caught.value.code, said.count("\n")) == (1, 1)
        assert said.startswith("error: ")
        assert words in said


def test_without_an_environment_or_a_start_nothing_can_be_driven(tmp_path: Path) -> None:
    named = find(str(write_models(tmp_path / "drift")), None, WHICH)
    with pytest.raises(ModelError, match=r"starts: missing.*or name the environment that is modelled with --env"):
        DrivenWorld.load(named, WHICH)


def test_another_environment_than_the_one_that_was_modelled_is_refused(tmp_path: Path) -> None:
    named = find(str(write_drift(tmp_path / "drift")), None, WHICH)
    with pytest.raises(DriveError, match=r"--environment CartPole-v1: it has states position, velocity, .* but the"):
        DrivenWorld.load(named, WHICH, "CartPole-v1")
    with pytest.raises(DriveError, match="'Nothing-v0' cannot be made"):
        environment_of(named, DrivenWorld.load(named, WHICH).world.model.features.spaces, "Nothing-v0")
