"""Bags of ROS 2: folders with a `metadata.yaml`, which says what files belong to them, in MCAP or in databases."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import yaml  # type: ignore[import-untyped]  # the stubs are a package of their own

from addressed_dynamics.base.errors import LogError

METADATA = "metadata.yaml"
"""The file that makes a folder a bag, and says which files belong to it."""

_COMPRESSED = (".zstd", ".zst")


def is_bag(path: Path) -> bool:
    """Say whether `path` is a folder that ROS 2 recorded."""
    return path.is_dir() and (path / METADATA).is_file()


def whole_bags(paths: Sequence[Path]) -> list[Path]:
    """Return the paths without what is inside a bag that is one of them; its metadata stand for a bag, too."""
    named = [path.parent if path.name == METADATA and is_bag(path.parent) else path for path in paths]
    bags = {path for path in named if is_bag(path)}
    return sorted({path for path in named if path in bags or path.parent not in bags})


def bag_files(folder: Path) -> tuple[Path, ...]:
    """Return the files of a bag in the order of recording.

    Raises:
        LogError: its metadata cannot be read, name no file or one that is not there, or say that it is compressed in a
            way that cannot be undone.
    """
    path = folder / METADATA
    about = _metadata(path)
    try:
        names = list(dict.fromkeys(PurePosixPath(each).name for each in about["relative_file_paths"]))
    except (KeyError, TypeError) as error:
        raise _no_metadata(path) from error
    if not names:
        message = f"{path}: the bag has no files; 'ros2 bag reindex {folder}' looks for them"
        raise LogError(message)
    if about.get("compression_format") not in (None, "", "zstd"):
        message = (
            f"{folder}: it is compressed by '{about['compression_format']}', and bags that zstd compressed can be "
            "read; make a plain one of it with 'ros2 bag convert'"
        )
        raise LogError(message)
    return tuple(_file(folder, name) for name in names)


def distro_beside(file: Path) -> str:
    """Return the distribution of ROS 2 that recorded the bag that a file lies in; empty if nothing says so."""
    try:
        return str(_metadata(file.with_name(METADATA)).get("ros_distro") or "")
    except LogError:
        return ""


def _metadata(path: Path) -> dict[str, Any]:
    try:
        document = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        message = f"{path}: the file cannot be read ({error.strerror})"
        raise LogError(message) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise _no_metadata(path) from error
    about = document.get("rosbag2_bagfile_information") if isinstance(document, dict) else None
    if not isinstance(about, dict):
        raise _no_metadata(path)
    return about


def _no_metadata(path: Path) -> LogError:
    return LogError(
        f"{path}: the file does not describe a bag of ROS 2; 'ros2 bag reindex {path.parent}' writes it anew"
    )


def _file(folder: Path, name: str) -> Path:
    """Return a file of a bag: what it was unpacked to, if it was compressed and somebody did so."""
    path = folder / name
    unpacked = path.with_suffix("") if path.suffix in _COMPRESSED else path
    if unpacked.is_file():
        return unpacked
    if not path.is_file():
        message = f"{path}: the file is not there, but {METADATA} names it; copy it, or run 'ros2 bag reindex {folder}'"
        raise LogError(message)
    return path
