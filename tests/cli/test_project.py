"""`init`: a project of one's own, all of it or nothing."""

import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
from projects import git
from ruamel.yaml import YAML
from stage_dependencies import ROOT
from test_new import run

from addressed_dynamics.base.params.experiments import load_experiment
from addressed_dynamics.cli import project
from addressed_dynamics.cli.project import TEMPLATES, VERSION_FILE, own_stages, project_files

WRITTEN = [".dvc", ".dvcignore", ".gitignore", "README.md", "dvc.yaml", "params.yaml", "pipeline", "released"]


def yaml(text: str) -> dict:
    return YAML(typ="safe", pure=True).load(text)


@pytest.fixture
def init(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    """`init` in a folder that is in no repository."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    return lambda *arguments: run(capsys, monkeypatch, "init", *arguments)


def files(folder: Path) -> dict[str, bytes]:
    found = (path for path in folder.rglob("*") if path.is_file() and ".git" not in path.relative_to(folder).parts)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in found}


def test_the_stages_of_a_project_are_those_of_the_repository_with_its_version_in_place_of_its_sources() -> None:
    theirs = yaml((ROOT / "dvc.yaml").read_text(encoding="utf-8"))
    own = yaml(own_stages((ROOT / "dvc.yaml").read_text(encoding="utf-8")))
    assert list(own) == ["stages"]
    assert list(own["stages"]) == list(theirs["stages"])
    for name, stage in theirs["stages"].items():
        deps = [dep for dep in stage["do"]["deps"] if not dep.startswith("${src}")]
        expected = {**stage, "do": {**stage["do"], "deps": [*deps, VERSION_FILE]}}
        found = own["stages"][name]
        assert found == expected


def test_the_params_of_a_project_have_every_mapping_that_a_stage_goes_over_and_no_experiment() -> None:
    stages = yaml((ROOT / "dvc.yaml").read_text(encoding="utf-8"))["stages"].values()
    over = {re.fullmatch(r"\$\{(\w+)\}", stage["foreach"])[1] for stage in stages}
    assert yaml(project_files()["params.yaml"]) == {"params_file": "params.yaml", **{name: {} for name in over}}


def test_a_project_has_the_scripts_of_the_repository_and_is_a_repository_of_its_own(init, tmp_path: Path) -> None:
    status, out, err = init("mine")
    assert (status, err) == (0, "")
    assert out.splitlines() == [
        "mine is a project: README.md says what is next; a Git repository was made there",
        "next: cd mine && addressed-dynamics new NAME path/to/logs",
    ]
    folder = tmp_path / "mine"
    assert sorted(path.name for path in folder.iterdir()) == [".dvc", *([".dvcignore", ".git"]), *WRITTEN[2:]]
    assert git(folder, "rev-parse", "--show-toplevel") == str(folder.resolve())
    for script in (ROOT / "pipeline").glob("*.py"):
        assert (folder / "pipeline" / script.name).read_bytes() == script.read_bytes()
    assert (folder / VERSION_FILE).read_text() == f"{version('addressed-dynamics')}\n"
    assert "analytics = false" in (folder / ".dvc" / "config").read_text()
    assert f"version {version('addressed-dynamics')}" in (folder / "README.md").read_text()


def test_an_experiment_is_added_to_a_project_as_to_the_repository(
    init, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    init("mine")
    monkeypatch.chdir(tmp_path / "mine")
    rows = "\n".join(f"{index / 20},{index % 7},{index % 3}" for index in range(400))
    (tmp_path / "mine" / "run.csv").write_text(f"t,angle,torque\n{rows}\n")
    status, _, err = run(capsys, monkeypatch, "new", "arm", "run.csv", "--observation", "angle", "--action", "torque",
                         "--rate", "20", "--yes")  # fmt: skip
    assert (status, err) == (0, "")
    assert load_experiment(Path("params.yaml"), "arm", "transitions").source.files == ("run.csv",)


@pytest.mark.parametrize("there", [["params.yaml"], ["pipeline", ".gitignore"]])
def test_what_is_in_the_way_is_listed_and_left_as_it_is(init, tmp_path: Path, there: list[str]) -> None:
    for name in there:
        (tmp_path / name).write_text("mine\n")
    before = files(tmp_path)
    status, out, err = init(".")
    assert (status, out) == (1, "")
    assert err == f"error: .: in the way are {', '.join(sorted(there))}; name a folder without them\n"
    assert files(tmp_path) == before
    assert not (tmp_path / ".git").exists()


def test_other_files_of_a_folder_stay_beside_the_project(init, tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    (tmp_path / "logs" / "a.mcap").write_text("mine\n")
    assert init(".")[0] == 0
    assert {path.name for path in tmp_path.iterdir()} == {*WRITTEN, ".git", "logs"}
    assert (tmp_path / "logs" / "a.mcap").read_text() == "mine\n"


def test_a_folder_of_a_repository_gets_none_of_its_own(init, tmp_path: Path) -> None:
    subprocess.run(["git", "init", "--quiet"], cwd=tmp_path, check=True)
    status, out, _ = init("deep/mine")
    assert status == 0
    assert "Git" not in out
    assert not (tmp_path / "deep" / "mine" / ".git").exists()


def test_ctrl_c_leaves_nothing_either(init, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(folder: Path) -> bool:
        (folder / ".git").mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr(project, "_init_git", interrupted)
    assert init("mine")[0] == 130
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["mine", "deep/mine", "."])
def test_a_project_that_cannot_be_finished_leaves_nothing(
    init, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "logs.csv").write_text("mine\n")
    before = files(tmp_path)

    def no_space(folder: Path) -> bool:
        assert (folder / "dvc.yaml").is_file()
        raise subprocess.CalledProcessError(128, "git", stderr="fatal: no space left\n")

    monkeypatch.setattr(project, "_init_git", no_space)
    status, out, err = init(name)
    assert (status, out) == (1, "")
    assert err == (f"error: {name}: the project cannot be written (fatal: no space left); nothing was left there\n")
    assert files(tmp_path) == before
    assert [path.name for path in tmp_path.iterdir()] == ["logs.csv"]


def test_what_is_no_folder_and_a_machine_without_git_are_said(
    init, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "file").touch()
    assert init("file")[2] == "error: file: not a folder\n"
    monkeypatch.setenv("PATH", "")
    assert "there is no program 'git'" in init("mine")[2]
    assert not (tmp_path / "mine").exists()


def test_a_project_is_renewed_unless_that_would_lose_what_git_does_not_have(init, tmp_path: Path) -> None:
    assert "no project" in init(".", "--renew")[2]
    init("mine")
    folder = tmp_path / "mine"
    (folder / ".git").rename(tmp_path / "elsewhere")
    assert "in no Git repository" in init("mine", "--renew")[2]
    (tmp_path / "elsewhere").rename(folder / ".git")
    assert "commit it first" in init("mine", "--renew")[2]
    (folder / VERSION_FILE).write_text("0.0.1\n")
    (folder / "pipeline" / "old.py").write_text("# of 0.0.1\n")
    (folder / "params.yaml").write_text("experiments: {}\n")
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "start")
    (folder / "dvc.yaml").write_text("stages: {}\n")
    status, _, err = init("mine", "--renew")
    assert status == 1
    assert "(dvc.yaml)" in err
    git(folder, "checkout", "dvc.yaml")
    assert init("mine", "--renew")[0] == 0
    assert {path.name for path in (folder / "pipeline").iterdir()} == {
        Path(name).name for name in project_files() if name.startswith("pipeline/")
    }
    assert (folder / "params.yaml").read_text() == "experiments: {}\n"
    assert git(folder, "status", "--porcelain").splitlines() == ["D pipeline/old.py", " M pipeline/version.txt"]


def test_stages_of_another_version_than_the_installed_do_not_run(init, tmp_path: Path) -> None:
    init("mine")
    (tmp_path / "mine" / VERSION_FILE).write_text("0.0.1\n")
    command = [sys.executable, "-m", "pipeline.convert", "arm", "--params", "params.yaml"]
    done = subprocess.run(command, cwd=tmp_path / "mine", capture_output=True, text=True, check=False)
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    assert f"are of addressed-dynamics 0.0.1, and {version('addressed-dynamics')} is installed" in line


def test_a_command_that_needs_an_extra_says_so_in_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mlflow", None)
    status, out, err = run(capsys, monkeypatch, "ui")
    assert (status, out) == (1, "")
    assert err == "error: this needs 'mlflow': pip install 'addressed-dynamics[pipeline]'\n"


def test_a_checkout_has_no_second_copy_of_the_stages() -> None:
    assert sorted(path.name for path in TEMPLATES.iterdir()) == ["README.md", "gitignore", "params.yaml"]
