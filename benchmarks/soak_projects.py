"""A small project before and after each of its stages, and how what a disturbed stage leaves is held against it."""

import hashlib
import json
import re
import shutil
import sqlite3
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from mcap.reader import make_reader
from soak_commands import Command

from pipeline_clones import edit_params, new_clone  # isort: skip - in the folder that soak_commands names

MUTABLE = ("data", ".dvc", ".mlflow", ".checkpoints", "dvc.lock")
"""What a stage changes in a project."""
LOGS = "examples/pendulum/logs"
"""What is imported."""

_CLOCK = re.compile(rb"^(<dt>|- )(Drawn|Trained in)\b.*\n", re.MULTILINE)
"""Lines of a report that say when, and how long."""
_WITH_CLOCK = ("report.html", "report.md")


_digests: dict[tuple[str, int, int], str] = {}
"""Of files that were read before, by name, size and time of the last change."""


@dataclass(frozen=True)
class Step:
    """A stage of an experiment."""

    stage: str
    experiment: str

    def __str__(self) -> str:
        """Return what DVC calls it."""
        return f"{self.stage}@{self.experiment}"


@dataclass(frozen=True)
class State:
    """What a project holds, as far as it does not depend on the clock."""

    files: Mapping[str, str]
    """Digest of each file below `data`, by its path."""
    stages: Mapping[str, Any]
    """What dvc.lock says of each stage."""


def make_project(folder: Path) -> Path:
    """Return a new project with the tiny params of the tests and a few foreign logs."""
    clone = folder / "project"
    clone.mkdir(parents=True)
    new_clone(clone)
    edit_params(clone, "imported: {}", f"imported: {{pendulum: {LOGS}}}")
    logs = [sys.executable, clone / "examples/pendulum/make_logs.py", "--out", clone / LOGS, "--episodes", "4"]
    subprocess.run([*logs, "--seconds", "6"], check=True, stdout=subprocess.DEVNULL)
    return clone


def save(clone: Path, snapshot: Path) -> None:
    """Keep what is mutable of a project in a new folder."""
    snapshot.mkdir(parents=True)
    _copy(clone, snapshot)


def restore(snapshot: Path, clone: Path) -> None:
    """Put a project back to a snapshot."""
    for name in MUTABLE:
        path = clone / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
    _copy(snapshot, clone)


def _copy(source: Path, target: Path) -> None:
    for name in MUTABLE:
        if (source / name).is_dir():
            shutil.copytree(source / name, target / name, symlinks=True)
        elif (source / name).exists():
            shutil.copy2(source / name, target / name)


def read_state(clone: Path) -> State:
    """Return what a project holds now."""
    return State(read_files(clone), read_stages(clone))


def read_files(clone: Path) -> dict[str, str]:
    """Return the digest of each file below `data`, but for partial ones, which nobody takes for whole."""
    found = {}
    for path in _files(clone / "data"):
        name, about = path.relative_to(clone).as_posix(), path.stat()
        key = name, about.st_size, about.st_mtime_ns
        if key not in _digests:
            _digests[key] = digest(path)
        found[name] = _digests[key]
    return found


def read_stages(clone: Path) -> dict[str, Any]:
    """Return what dvc.lock says of each stage."""
    lock = clone / "dvc.lock"
    document = yaml.load(lock.read_text(encoding="utf-8"), yaml.CSafeLoader) if lock.exists() else {"stages": {}}
    return {name: _without_clock(stage) for name, stage in document["stages"].items()}


def digest(path: Path) -> str:
    """Return a digest of what a file says, but for when that was said."""
    if path.suffix == ".mcap":
        return _digest_of_log(path)
    content = path.read_bytes()
    if path.name in _WITH_CLOCK:
        content = _CLOCK.sub(b"", content)
    return hashlib.sha256(content).hexdigest()


def _digest_of_log(path: Path) -> str:
    found = hashlib.sha256()
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            found.update(f"{schema and schema.name} {channel.topic} {message.log_time}".encode())
            found.update(message.data)
        for record in reader.iter_metadata():
            kept = {key: value for key, value in record.metadata.items() if key not in {"started", "crc32"}}
            found.update(json.dumps([record.name, kept], sort_keys=True).encode())
    return found.hexdigest()


def _files(folder: Path) -> Iterator[Path]:
    for path in sorted(folder.rglob("*")):
        if path.is_file() and not any(part.endswith(".partial") for part in path.parts):
            yield path


def _without_clock(stage: Mapping[str, Any]) -> dict[str, Any]:
    """Return what dvc.lock says of a stage without digests of what holds the time: raw logs and reports."""

    def timeless(entry: Mapping[str, Any]) -> dict[str, Any]:
        path = entry["path"]
        holds_time = path.startswith("data/raw/") or Path(path).name in _WITH_CLOCK
        return {"path": path} if holds_time else dict(entry)

    return {
        key: [timeless(each) for each in value] if key in {"deps", "outs"} else value for key, value in stage.items()
    }


def differences(clone: Path, expected: State) -> list[str]:
    """Say in which files and stages a project differs from what it should be."""
    try:
        found = read_state(clone)
    except Exception as error:  # a damaged log or lock raises what its reader does
        return [f"cannot be read: {type(error).__name__}: {error}"]
    return [*_apart("file", found.files, expected.files), *_apart("stage", found.stages, expected.stages)]


def _apart(what: str, found: Mapping[str, Any], expected: Mapping[str, Any]) -> list[str]:
    names = sorted(found.keys() | expected.keys())
    words = {name: _how(name, found, expected) for name in names if found.get(name) != expected.get(name)}
    return [f"{what} {name} {how}" for name, how in words.items()]


def _how(name: str, found: Mapping[str, Any], expected: Mapping[str, Any]) -> str:
    if name not in found:
        return "is missing"
    return "differs" if name in expected else "should not be there"


def half_written(clone: Path, before: State, after: State) -> list[str]:
    """Say what a reader would take for whole and is not: every output has to be as before the stage, as after, or gone.

    The runs in MLflow's store have to be readable, too.
    """
    try:
        found = read_files(clone)
    except Exception as error:  # a damaged log raises what its reader does
        return [f"cannot be read: {type(error).__name__}: {error}"]
    faults = []
    outs = {each["path"] for stage in after.stages.values() for each in stage.get("outs", [])}
    for out in sorted(outs):
        now, *possible = (_inside(files, out) for files in (found, before.files, after.files))
        if now and now not in possible:
            faults.append(f"{out} is half written: {'; '.join(_apart('file', now, possible[1])[:3])}")
    faults += [f"{name} is of no stage" for name in found if not any(Path(name).is_relative_to(out) for out in outs)]
    if (clone / ".mlflow" / "mlflow.db").exists() and (answer := _integrity(clone / ".mlflow")) != "ok":
        faults.append(f"mlflow.db cannot be read: {answer}")
    return faults


def half_written_by_dvc(clone: Path, before: State, after: State) -> list[str]:
    """Return which of DVC's own files are half written.

    It writes two in place, and stumbles over entries of its cache of runs that have no content yet.
    """
    runs = clone / ".dvc" / "cache" / "runs"
    found = [path.relative_to(clone).as_posix() for path in runs.glob("*/*") if not any(path.glob("[!.]*"))]
    locks, lock = clone / ".dvc" / "tmp" / "rwlock", clone / "dvc.lock"
    if locks.exists():
        try:
            json.loads(locks.read_text(encoding="utf-8"))
        except ValueError:
            found.append(".dvc/tmp/rwlock")
    try:
        stages = read_stages(clone)
        whole = stages in (before.stages, after.stages)
    except Exception:  # whatever a YAML reader raises
        whole = False
    return [*found, *([] if whole or not lock.exists() else ["dvc.lock"])]


def repair(clone: Path, snapshot: Path, half: list[str]) -> None:
    """Do by hand what DVC's half written files need: dvc.lock is put back to before the stage, the others go."""
    for name in half:
        if (clone / name).is_dir():
            shutil.rmtree(clone / name)
        elif name == "dvc.lock" and (snapshot / name).exists():
            shutil.copy2(snapshot / name, clone / name)
        else:
            (clone / name).unlink()


def _inside(files: Mapping[str, str], out: str) -> dict[str, str]:
    return {name: value for name, value in files.items() if Path(name).is_relative_to(out)}


def _integrity(store: Path) -> str:
    """Return what SQLite finds in a copy of a store's database: whoever reads the store itself may still hold it."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("mlflow.db-journal", "mlflow.db"):
            if (store / name).exists():
                shutil.copy2(store / name, folder)
        try:
            with closing(sqlite3.connect(Path(folder) / "mlflow.db")) as connection:
                return str(connection.execute("PRAGMA integrity_check").fetchone()[0])
        except sqlite3.Error as error:
            return str(error)


def leftovers(clone: Path, temporary: Path) -> dict[str, int]:
    """Count what a stage that ended well has left: partial files, checkpoints, and entries of the temporary folder."""
    partial = [path for name in ("data", ".checkpoints") for path in (clone / name).rglob("*.partial")]
    kept = [path for path in (clone / ".checkpoints").rglob("*") if path.is_file() and path.suffix != ".partial"]
    others = [path for path in temporary.iterdir() if not path.name.startswith("torchinductor_")]  # one for each user
    counts = {"partial": len(partial), "checkpoints": len(kept), "temporary": len(others)}
    return {name: number for name, number in counts.items() if number}


def run(clone: Path, step: Step, log: Path, settings: Mapping[str, str]) -> float:
    """Run a stage that nothing disturbs; return how many seconds it took."""
    command = Command(clone, "repro", "--single-item", str(step), log=log, settings=settings)
    status = command.status()
    if status != 0:
        message = f"{step} ended with status {status} although nothing disturbed it:\n{command.log}"
        raise RuntimeError(message)
    return command.seconds
