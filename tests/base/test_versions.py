import os
import shutil
import subprocess
from pathlib import Path

import pytest
import yaml  # type: ignore[import-untyped]  # the stubs are a package of their own

from addressed_dynamics.base.versions import code_version, data_digest, output_digests, tree_digest

MD5 = "0123456789abcdef0123456789abcdef"
LOCK = """
schema: '2.0'
stages:
  convert@mountaincar:
    outs:
    - path: data/tables/mountaincar
      hash: md5
      md5: 0123456789abcdef0123456789abcdef.dir
    - path: data/reports/mountaincar/data.json
      hash: md5
      md5: 12345678901234567890123456789012
"""


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / ".dvc").mkdir()
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DVC_ROOT", raising=False)
    return tmp_path


def write_models(folder: Path) -> Path:
    files = {
        "ensemble/ensemble.json": "{}",
        "ensemble/seed-0/config.json": "{}",
        "ensemble/seed-0/weights.safetensors": "weights",
        "baselines/same_size/seed-0/network/config.json": "{}",
    }
    for name, text in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text)
    return folder


def test_each_innermost_folder_of_an_output_has_a_digest(tmp_path: Path) -> None:
    assert list(output_digests(write_models(tmp_path))) == ["baselines/same_size/seed-0/network", "ensemble/seed-0"]
    assert list(output_digests(tmp_path / "ensemble" / "seed-0")) == ["."]


def test_the_digest_of_an_output_depends_on_its_files_and_on_nothing_else(tmp_path: Path) -> None:
    models = write_models(tmp_path / "models")
    before = output_digests(models)
    for file in sorted(models.rglob("*.json"), reverse=True):
        os.utime(file, (0, 0))
    shutil.copytree(models, tmp_path / "other machine")
    assert output_digests(tmp_path / "other machine") == before
    assert tree_digest(tmp_path / "other machine") == tree_digest(models)
    # By hand: the SHA-256 of, for each file, its own SHA-256, a space, its name and a zero byte; the first 16 digits.
    assert before["ensemble/seed-0"] == "7b94a2bb3bcd6e52"


def test_the_digest_of_a_tree_depends_on_every_file_and_on_its_place(tmp_path: Path) -> None:
    models = write_models(tmp_path)
    found = {tree_digest(models)}
    (models / "ensemble" / "ensemble.json").write_text("{ }")  # which no innermost folder holds
    found.add(tree_digest(models))
    (models / "ensemble" / "ensemble.json").rename(models / "ensemble.json")
    found.add(tree_digest(models))
    assert len(found) == 3


@pytest.mark.parametrize("edit", ["content", "name", "swap", "more"])
def test_an_output_with_other_files_has_another_digest(tmp_path: Path, edit: str) -> None:
    folder = write_models(tmp_path) / "ensemble" / "seed-0"
    before, weights, config = output_digests(folder), folder / "weights.safetensors", folder / "config.json"
    match edit:
        case "content":
            weights.write_text("other weights")
        case "name":
            weights.rename(folder / "other.safetensors")
        case "swap":
            weights.write_text("{}")
            config.write_text("weights")
        case "more":
            (folder / "more.json").touch()
    assert output_digests(folder) != before


def test_the_digest_of_data_is_what_dvc_has_for_them(project: Path) -> None:
    (project / "dvc.lock").write_text(LOCK)
    assert data_digest(Path("data/tables/mountaincar")) == MD5
    assert data_digest(project / "data" / "reports" / "mountaincar" / "data.json") == "12345678901234567890123456789012"
    assert data_digest(Path("data/tables/acrobot")) is None
    assert data_digest(project.parent) is None


def test_the_lock_is_parsed_once_until_it_changes(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (project / "dvc.lock").write_text(LOCK)
    parsed: list[str] = []
    load = yaml.load
    monkeypatch.setattr(yaml, "load", lambda text, loader: parsed.append(text) or load(text, loader))
    for _ in range(3):
        assert data_digest(Path("data/tables/mountaincar")) == MD5
    assert len(parsed) == 1
    (project / "dvc.lock").write_text(LOCK.replace("0123", "ffff"))
    os.utime(project / "dvc.lock", (1, 1))
    assert data_digest(Path("data/tables/mountaincar")) == "ffff" + MD5[4:].replace("0123", "ffff")
    assert len(parsed) == 2


@pytest.mark.parametrize(
    "lock", [None, "", "stages: [", "stages: {}", "stages: {convert: {outs: [{path: 1}]}}", "\x00"]
)
def test_without_a_usable_dvc_lock_there_is_no_digest(project: Path, lock: str | None) -> None:
    if lock is not None:
        (project / "dvc.lock").write_text(lock)
    assert data_digest(project / "data" / "tables" / "mountaincar") is None


@pytest.mark.usefixtures("project")
def test_the_version_of_the_code_is_its_commit_and_whether_it_was_changed() -> None:
    assert code_version() == ""

    def git(*arguments: str) -> str:
        identity = ["-c", "user.name=n", "-c", "user.email=e@example.org"]
        return subprocess.run(["git", *identity, *arguments], check=True, capture_output=True, text=True).stdout.strip()

    Path("code.py").write_text("")
    git("init", "--quiet")
    git("add", "code.py")
    git("commit", "--quiet", "--message", "start")
    assert code_version() == git("rev-parse", "HEAD")
    Path("code.py").write_text("pass")
    assert code_version() == f"{git('rev-parse', 'HEAD')}, with changes"
