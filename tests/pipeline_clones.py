"""Clones of this working tree with the tiny params, in which DVC runs the pipeline."""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

import warm_python
from filelock import FileLock
from stage_dependencies import ROOT

KINDS = {"mountaincar": "transitions", "acrobot": "transitions", "pfnn": "motion"}
"""The experiments of the tiny params, with their kind of data."""
STAGES = (
    "record",
    "convert",
    "train_ensemble",
    "train_addressing",
    "train_baselines",
    "evaluate",
    "train_policy",
    "report",
)
"""The stages that each of them goes through."""
_servers = list[subprocess.Popen[str]]()
"""Nobody waits for them: another process may need them longer than the one that started them."""


def environment(clone: Path) -> dict[str, str]:
    """The environment of a user of `clone`: its own sources, its own store, the interpreter that runs the tests."""
    names = {"DVC_ROOT", "DVC_EXP_NAME", "MLFLOW_TRACKING_URI"}
    kept = {name: value for name, value in os.environ.items() if name not in names}
    path = f"{Path(sys.executable).parent}{os.pathsep}{kept.get('PATH', '')}"
    return {
        **kept,
        "PATH": path,
        "PYTHONPATH": str(clone / "src"),
        "DVC_NO_ANALYTICS": "true",
        "ADDRESSED_DYNAMICS_PROCESSES": "1",
    }


@cache
def warm_interpreter() -> Path:
    """The folder of a `python` that has imported the packages already: one for all processes that run these tests.

    Whoever needs it first starts its server, which lives as long as one of them.
    """
    run = os.environ.get("PYTEST_XDIST_TESTRUNUID")
    folder = Path(tempfile.gettempdir(), f"warm-python-{run}") if run else Path(tempfile.mkdtemp(prefix="warm-python-"))
    folder.mkdir(mode=0o700, exist_ok=True)
    with FileLock(folder / "lock"):
        if not (folder / "python").exists():
            _start_warm(folder)
        os.open(folder / "users", os.O_WRONLY)  # until this process ends
    return folder


def _start_warm(folder: Path) -> None:
    os.mkfifo(folder / "users")
    names = {"PYTHONPATH", "MLFLOW_TRACKING_URI"}
    settings = {name: value for name, value in os.environ.items() if name not in names}
    settings |= {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    server = subprocess.Popen(
        [sys.executable, warm_python.__file__, str(folder)],
        env=settings | {"MLFLOW_DISABLE_TELEMETRY": "true"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    _servers.append(server)
    assert server.stdout is not None
    with server.stdout as said:
        assert said.readline() == warm_python.READY
    program = folder / "python"
    program.write_text(warm_python.SHIM.format(python=sys.executable, path=str(folder / "socket")), encoding="utf-8")
    program.chmod(0o755)


def dvc_command(clone: Path, *arguments: str) -> tuple[list[str], dict[str, str]]:
    """A DVC command in `clone` and its environment. It and its stages are run by the warm interpreter."""
    warm, settings = warm_interpreter(), environment(clone)
    path = f"{warm}{os.pathsep}{settings['PATH']}"
    return [str(warm / "python"), "-m", "dvc", *arguments], settings | {"PATH": path}


def dvc(clone: Path, *arguments: str) -> str:
    """What a DVC command says, which has to succeed."""
    command, settings = dvc_command(clone, *arguments)
    done = subprocess.run(
        command, cwd=clone, env=settings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    return done.stdout


def stages_run(output: str) -> list[str]:
    return re.findall(r"Running stage '([^']+)'", output)


def listed_files() -> list[str]:
    """The files of this working tree that Git does not ignore, relative to its root."""
    listing = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    return [name for name in listing.stdout.split("\0") if name and (ROOT / name).is_file()]


def new_clone(folder: Path) -> Path:
    """A Git repository with this working tree and the tiny params."""
    for name in listed_files():
        if not name.startswith("data/"):
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, folder / name)
    shutil.copy(ROOT / "tests" / "tiny_params.yaml", folder / "params.yaml")
    (folder / "dvc.lock").unlink(missing_ok=True)
    identity = ["-c", "user.name=test", "-c", "user.email=test@example.org"]
    for arguments in (["init", "--quiet"], ["add", "--all"], [*identity, "commit", "--quiet", "--message", "start"]):
        subprocess.run(["git", *arguments], cwd=folder, check=True)
    return folder


def edit_params(clone: Path, old: str, new: str) -> None:
    text = (clone / "params.yaml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    (clone / "params.yaml").write_text(text.replace(old, new), encoding="utf-8")
