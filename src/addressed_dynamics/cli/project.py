"""`addressed-dynamics init`: a project of one's own, with the stages of this one."""

from __future__ import annotations

import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from addressed_dynamics.base.errors import AddressedDynamicsError

TEMPLATES = Path(__file__).with_name("templates")
PACKAGED = TEMPLATES / "repository"
"""What a project has in common with the repository, as setup.py puts it into a wheel; a checkout has no such folder."""
PIPELINE = "pipeline"
STAGES = "dvc.yaml"
VERSION_FILE = f"{PIPELINE}/version.txt"
"""The version of this package that the stages are of; pipeline/__init__.py compares it with the installed one."""

_STAGES = re.compile(r"(?m)^stages:\n(?:(?: .*)?\n)*")
_CODE = re.compile(r"(?m)^( +- )\$\{src\}/.*\n(?: +- \$\{src\}/.*\n)*")
_HEAD = """\
# The pipeline: one copy of each stage per experiment. `params_file`, `experiments`, `recorded` and `imported` come from
# params.yaml; 'dvc exp run -S params_file=FILE' lays another file over it. Both are watched.
#
# A stage depends on its script, and on the version of addressed-dynamics in {version_file}.

"""


class ProjectError(AddressedDynamicsError):
    """A project cannot be written where it is asked for."""


def make_project(folder: Path) -> bool:
    """Write a project into a folder, which is made if it is not there; all of it or nothing.

    Returns:
        Whether a Git repository was made there, because the folder was in none.

    Raises:
        ProjectError: files are in the way, Git is missing, or the folder cannot be written.
    """
    if shutil.which("git") is None:
        message = f"{folder}: a project is a Git repository, and there is no program 'git'; install it first"
        raise ProjectError(message)
    files = project_files()
    names = sorted({Path(name).parts[0] for name in files})
    _check_free(folder, names)
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    new = [folder / name for name in (*names, ".git") if not (folder / name).exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _put(folder, files, names)
        return _init_git(folder)
    except BaseException as error:
        for path in new:
            _remove(path)
        for each in made:
            with suppress(OSError):
                each.rmdir()
        if not isinstance(error, OSError | subprocess.SubprocessError):
            raise
        message = f"{folder}: the project cannot be written ({_reason(error)}); nothing was left there"
        raise ProjectError(message) from error


def renew_project(folder: Path) -> None:
    """Write the stages of a project anew, those of the installed version; params, data and README stay.

    Raises:
        ProjectError: there is no project, its stages have changes that Git does not have, or it cannot be written.
    """
    if not (folder / VERSION_FILE).is_file():
        message = f"{folder}: no project that 'addressed-dynamics init' made: there is no {VERSION_FILE}"
        raise ProjectError(message)
    if _git(folder, "rev-parse", "--is-inside-work-tree") != "true":
        message = f"{folder}: in no Git repository, so nothing would be left of what is replaced; 'git init' it first"
        raise ProjectError(message)
    changed = _git(folder, "status", "--porcelain", "--", STAGES, PIPELINE).splitlines()
    if changed:
        paths = ", ".join(line[3:] for line in changed)
        message = f"{folder}: Git does not have what would be replaced ({paths}); commit it first"
        raise ProjectError(message)
    files = {name: text for name, text in project_files().items() if Path(name).parts[0] in {STAGES, PIPELINE}}
    try:
        _put(folder, files, [PIPELINE, STAGES])
    except OSError as error:
        message = (
            f"{folder}: the stages cannot be written ({_reason(error)}); 'git checkout .' brings back what was there"
        )
        raise ProjectError(message) from error


def project_files() -> dict[str, str]:
    """Return the text of every file of a project, by its path there.

    Raises:
        ProjectError: this installation lacks them.
    """
    number = version("addressed-dynamics")
    files = dict(_common_files())
    files[STAGES] = own_stages(files[STAGES])
    files[VERSION_FILE] = f"{number}\n"
    files["params.yaml"] = (TEMPLATES / "params.yaml").read_text(encoding="utf-8")
    files["README.md"] = (TEMPLATES / "README.md").read_text(encoding="utf-8").replace("{version}", number)
    files[".gitignore"] = (TEMPLATES / "gitignore").read_text(encoding="utf-8")
    return files


def own_stages(text: str) -> str:
    """Return a dvc.yaml without what only the repository has: its sources, and plots of its experiments.

    A stage that depends on folders of sources depends on the version instead.
    """
    (stages,) = _STAGES.findall(text)
    return _HEAD.format(version_file=VERSION_FILE) + _CODE.sub(rf"\g<1>{VERSION_FILE}\n", stages).rstrip("\n") + "\n"


def _common_files() -> Iterator[tuple[str, str]]:
    """Yield path and text of every file that a project has in common with the repository."""
    root = PACKAGED if PACKAGED.is_dir() else Path(__file__).parents[3]
    found = [root / STAGES, root / ".dvcignore", root / ".dvc" / "config", root / ".dvc" / ".gitignore"]
    found += [*(root / PIPELINE).glob("*.py"), root / "released" / "README.md", root / "released" / ".gitignore"]
    for path in sorted(found):
        try:
            yield path.relative_to(root).as_posix(), path.read_text(encoding="utf-8")
        except OSError as error:
            message = f"{path}: missing, so there is no project to write; install the package again"
            raise ProjectError(message) from error


def _check_free(folder: Path, names: list[str]) -> None:
    if folder.exists() and not folder.is_dir():
        message = f"{folder}: not a folder"
        raise ProjectError(message)
    there = [name for name in names if (folder / name).exists() or (folder / name).is_symlink()]
    if there:
        renew = ", or '--renew' for another version's stages" if (folder / VERSION_FILE).is_file() else ""
        message = f"{folder}: in the way are {', '.join(there)}; name a folder without them{renew}"
        raise ProjectError(message)


def _put(folder: Path, files: dict[str, str], names: list[str]) -> None:
    """Write files beside their places first, then put them there."""
    with tempfile.TemporaryDirectory(prefix=".init-", suffix=".partial", dir=folder) as temporary:
        for name, text in files.items():
            path = Path(temporary, "new", name)
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        for name in names:
            if (folder / name).exists():
                (folder / name).replace(Path(temporary, name))
            Path(temporary, "new", name).replace(folder / name)


def _init_git(folder: Path) -> bool:
    if _git(folder, "rev-parse", "--is-inside-work-tree") == "true":
        return False
    subprocess.run(["git", "init", "--quiet"], cwd=folder, check=True, capture_output=True, text=True, timeout=60)
    return True


def _git(folder: Path, *arguments: str) -> str:
    """Return what Git says of a folder; nothing if that is in no repository."""
    done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=False, timeout=60)
    return done.stdout.strip("\n")


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _reason(error: OSError | subprocess.SubprocessError) -> str:
    said = getattr(error, "stderr", None) or getattr(error, "strerror", None) or str(error)
    return str(said).strip().partition("\n")[0]
