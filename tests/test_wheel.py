"""What is in a wheel, and what an installation of it without extras can do."""

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterable, Iterator
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from pipeline_clones import listed_files
from stage_dependencies import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
PACKAGED = "addressed_dynamics/cli/templates/repository/"


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of this working tree, built from an archive of the sources of a copy of it."""
    source, target = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("dist")
    for name in listed_files():
        if not name.startswith(("tests/", "docs/", "benchmarks/", "data/")):
            (source / name).parent.mkdir(parents=True, exist_ok=True)
            (source / name).write_bytes((ROOT / name).read_bytes())
    build = ["-c", "import sys; from setuptools import build_meta; build_meta.build_sdist(sys.argv[1])", target]
    subprocess.run([sys.executable, *build], cwd=source, check=True, capture_output=True, text=True)
    (archive,) = target.iterdir()
    wheel = ["-m", "pip", "--quiet", "wheel", "--no-deps", "--no-build-isolation", "--wheel-dir", target, archive]
    subprocess.run([sys.executable, *wheel], check=True, capture_output=True, text=True)
    archive.unlink()
    (path,) = target.iterdir()
    return path


def test_a_wheel_holds_the_package_and_the_stages_and_nothing_else(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if ".dist-info/" not in name}
        package = {name.removeprefix("src/") for name in listed_files() if name.startswith("src/")}
        common = {name.removeprefix(PACKAGED) for name in names - package}
        assert names == package | {f"{PACKAGED}{name}" for name in common}
        assert {"dvc.yaml", ".dvcignore", ".dvc/config", "pipeline/stage.py", "released/README.md"} <= common
        assert {name for name in listed_files() if re.fullmatch(r"pipeline/[^/]*\.py", name)} <= common
        for name in common:
            assert archive.read(f"{PACKAGED}{name}") == (ROOT / name).read_bytes()


def test_a_project_from_a_wheel_is_that_of_a_checkout(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    program = (
        "from addressed_dynamics.cli import project; print(project.__file__, sorted(project.project_files().items()))"
    )
    found = [
        subprocess.run(
            [sys.executable, "-c", program], cwd="/", env={"PYTHONPATH": str(path)}, capture_output=True, text=True,
            check=True,
        ).stdout.split(maxsplit=1)
        for path in (tmp_path, ROOT / "src")
    ]  # fmt: skip
    (file, files), (other, same) = found
    assert Path(file).is_relative_to(tmp_path)
    assert not Path(other).is_relative_to(tmp_path)
    assert files == same


def test_nothing_that_is_said_names_a_file_that_a_wheel_does_not_have() -> None:
    named = {
        f"{path.name}:{each.lineno}"
        for path in (ROOT / "src").rglob("*.py")
        for each in spoken(ast.parse(path.read_text(encoding="utf-8")))
        if re.search(r"\b(docs|examples|benchmarks)/|'make ", str(each.value))
    }
    assert named == set()
    packaged = [path for path in (ROOT / "src").rglob("templates/*") if path.is_file()]
    assert packaged
    assert not [path for path in packaged if "docs/" in path.read_text(encoding="utf-8")]


def spoken(module: ast.Module) -> Iterator[ast.Constant]:
    """Yield the texts of a module, without docstrings, but with those that a command prints as its help."""
    silent = {id(each.value) for each in ast.walk(module) if isinstance(each, ast.Expr)}
    for each in ast.walk(module):
        if isinstance(each, ast.FunctionDef) and any(
            "app.command" in ast.unparse(line) for line in each.decorator_list
        ):
            silent -= {id(line.value) for line in each.body[:1] if isinstance(line, ast.Expr)}
    for each in ast.walk(module):
        if isinstance(each, ast.Constant) and isinstance(each.value, str) and id(each) not in silent:
            yield each


def installed_with(requirements: Iterable[str]) -> set[str]:
    """The distributions that come with these requirements, as far as they are installed here."""
    waiting, found = [Requirement(each) for each in requirements], set[str]()
    while waiting:
        each = waiting.pop()
        name = re.sub(r"[-_.]+", "-", each.name).lower()
        if name in found or (each.marker and not each.marker.evaluate({"extra": ""})):
            continue
        try:
            waiting += [Requirement(needed) for needed in distribution(each.name).requires or ()]
        except PackageNotFoundError:
            continue
        found.add(name)
    return found


WITHOUT_EXTRAS = """
import importlib, pkgutil, sys

class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in MISSING:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

MISSING = set(sys.argv[1].split())
sys.meta_path.insert(0, Missing())
import addressed_dynamics
for name in addressed_dynamics.__all__:
    getattr(addressed_dynamics, name)
for module in pkgutil.walk_packages(addressed_dynamics.__path__, "addressed_dynamics."):
    try:
        importlib.import_module(module.name)
    except ModuleNotFoundError as error:
        print(module.name, error.name.partition(".")[0])
"""


@pytest.mark.slow
def test_without_extras_all_but_reports_and_learners_is_there() -> None:
    there = installed_with(PROJECT["dependencies"])
    assert not there & {"mlflow", "dvc", "stable-baselines3", "matplotlib", "pillow", "tqdm", "pandas"}
    homes = packages_distributions()
    missing = {
        module
        for module, names in homes.items()
        if not {re.sub(r"[-_.]+", "-", each).lower() for each in names} & there
    } - {"addressed_dynamics", "pipeline", "_distutils_hack"}
    command = [sys.executable, "-c", WITHOUT_EXTRAS, " ".join(sorted(missing))]
    done = subprocess.run(command, cwd="/", env={"PYTHONPATH": str(ROOT / "src")}, capture_output=True, text=True,
                          check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    needs = dict(line.split() for line in done.stdout.splitlines())
    assert set(needs.values()) == {"matplotlib", "PIL", "stable_baselines3"}
    needing = {name.removeprefix("addressed_dynamics.") for name in needs}
    others = {name for name in needing if not name.startswith("reporting.")}
    assert others == {
        "policies.learning", "policies.offline", "policies.suite", "recording.dqn", "recording.plan",
        "simulators.stable_baselines",
    }  # fmt: skip
