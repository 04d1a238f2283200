"""Which files somebody means: the logs of one kind in files and folders, and how `source` names them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from glob import escape
from pathlib import Path

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.ros_bags import METADATA, bag_files, is_bag

SUFFIXES = {".mcap": "mcap", ".db3": "mcap", ".csv": "csv", ".tsv": "csv", ".parquet": "parquet"}
"""The kind of source that reads a file, by how its name ends."""


@dataclass(frozen=True)
class Found:
    """Files that one source reads."""

    kind: str
    """The kind of source."""
    files: tuple[Path, ...]
    patterns: tuple[str, ...]
    """How `source` names them."""
    dependency: str
    """The file or folder that holds all of them, for DVC to watch."""

    @property
    def folder(self) -> str:
        """The folder that all files are in.

        Raises:
            LogError: they are in several.
        """
        folders = {file.parent for file in self.files}
        if len(folders) > 1:
            shown = ", ".join(sorted(map(str, folders))[:3])
            message = (
                f"logs of transitions have to be in one folder, but these are in {len(folders)} ({shown}); give one"
            )
            raise LogError(message)
        return _shown(folders.pop())


def find_logs(paths: Sequence[Path]) -> Found:
    """Find the logs in files and folders, which have to be of one kind.

    Raises:
        LogError: there is nothing, nothing that can be imported, or logs of several kinds.
    """
    for path in paths:
        check_there(path)
    if len(paths) == 1 and (dataset := _dataset(paths[0])):
        return Found(dataset, (paths[0],), (_shown(paths[0]),), _shown(paths[0]))
    inside = {path: _inside(path) for path in paths}
    files = list(dict.fromkeys(file for found in inside.values() for file in found))
    kinds = Counter(SUFFIXES[file.suffix.lower()] for file in files)
    where = ", ".join(map(str, paths))
    if not kinds:
        known = ", ".join(f"*{suffix}" for suffix in SUFFIXES)
        message = f"{where}: expected logs or tables ({known}), but there are none; give another folder"
        raise LogError(message)
    if len(kinds) > 1:
        counts = ", ".join(f"{count} of kind {kind}" for kind, count in kinds.items())
        message = f"{where}: expected files of one kind, but there are {counts}; name the files or a folder of one kind"
        raise LogError(message)
    patterns = dict.fromkeys(pattern for path, found in inside.items() for pattern in _patterns(path, found))
    return Found(next(iter(kinds)), tuple(files), tuple(patterns), _shown(_common(paths)))


def check_there(path: Path) -> None:
    """Do nothing if `path` is a file, or a folder that can be looked into.

    Raises:
        LogError: it is not.
    """
    try:
        there = path.exists()
        if there and path.is_dir():
            list(path.iterdir())
    except OSError as error:
        message = f"{path}: it cannot be read ({error.strerror}); ask whoever owns it, or copy it"
        raise LogError(message) from error
    if not there:
        message = f"{path}: there is no such file or folder; give logs, tables or folders of them"
        raise LogError(message)


def _dataset(path: Path) -> str | None:
    """Return the kind of a folder that is a dataset as a whole."""
    if (path / "meta" / "info.json").is_file():
        return "lerobot"
    return "minari" if any((path / "data" / name).is_file() for name in ("metadata.json", "main_data.hdf5")) else None


def _inside(path: Path) -> list[Path]:
    """Return the files in a folder, those of a bag in the order of recording."""
    if not path.is_dir():
        return [path] if path.suffix.lower() in SUFFIXES else []
    bags = sorted(each.parent for each in path.rglob(METADATA))
    loose = (file for file in path.rglob("*") if file.suffix.lower() in SUFFIXES and file.is_file())
    return [
        *(file for bag in bags for file in bag_files(bag)),
        *sorted(file for file in loose if file.parent not in bags),
    ]


def _patterns(path: Path, files: Sequence[Path]) -> list[str]:
    shown = escape(_shown(path))
    if not path.is_dir() or is_bag(path):
        return [shown]
    bags = [f"{shown}/**/{METADATA}"] if any(is_bag(file.parent) for file in files) else []
    loose = [file for file in files if not is_bag(file.parent)]
    deep = any(file.parent != path for file in loose)
    suffixes = dict.fromkeys(file.suffix for file in loose)
    return [*bags, *(f"{shown}/{'**/' if deep else ''}*{suffix}" for suffix in suffixes)]


def _common(paths: Sequence[Path]) -> Path:
    if len(paths) == 1:
        return paths[0]
    return Path(os.path.commonpath([_absolute(path if path.is_dir() else path.parent) for path in paths]))


def _shown(path: Path) -> str:
    """Return a path as a params file names it: relative to where the pipeline runs if it lies in there."""
    absolute = _absolute(path)
    return absolute.relative_to(Path.cwd()).as_posix() if absolute.is_relative_to(Path.cwd()) else absolute.as_posix()


def _absolute(path: Path) -> Path:
    """Return an absolute path; links in it stay, for somebody chose them."""
    return Path(os.path.normpath(Path.cwd() / path))
