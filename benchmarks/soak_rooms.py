"""Where a project lies that is disturbed: a folder, or a small file system whose room can be taken away."""

import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from soak_commands import kill_all

ROOM = 1 << 31
"""Bytes of the small file system while there is room."""


class Room:
    """Where a project, its temporary files and DVC's notes lie."""

    def __init__(self, folder: Path, clone: Path) -> None:
        self.clone, self._folder = clone, folder
        self._folder.mkdir(parents=True, exist_ok=True)

    @property
    def temporary(self) -> Path:
        """The folder for temporary files."""
        return self._folder / "tmp"

    @property
    def settings(self) -> dict[str, str]:
        """What commands have to be told."""
        return {"TMPDIR": str(self.temporary), "DVC_SITE_CACHE_DIR": str(self._folder / "site")}

    def clear(self) -> None:
        """Remove what earlier commands left beside the project."""
        for folder in (self.temporary, self._folder / "site"):
            shutil.rmtree(folder, ignore_errors=True)
        self.temporary.mkdir()


class SmallRoom(Room):
    """The same on a file system that can be filled."""

    def fill(self) -> None:
        """Leave no byte."""
        for _ in range(100):
            used = os.statvfs(self._folder)
            size = (used.f_blocks - used.f_bfree) * used.f_frsize
            if _mount("-o", f"remount,size={size}", self._folder).returncode == 0:
                return
        message = f"{self._folder}: could not be filled"
        raise RuntimeError(message)

    def make_room(self) -> None:
        """Let there be room again."""
        _mount("-o", f"remount,size={ROOM}", self._folder).check_returncode()


@contextmanager
def small_file_system(folder: Path, project: Path) -> Iterator[SmallRoom]:
    """Yield a copy of a project on a file system of its own, in memory."""
    folder.mkdir(exist_ok=True)
    _mount("-t", "tmpfs", "-o", f"size={ROOM}", "soak", folder).check_returncode()
    try:
        shutil.copytree(project, folder / "project", symlinks=True)
        yield SmallRoom(folder, folder / "project")
    finally:
        kill_all(folder)
        subprocess.run(["umount", folder], check=True)


def may_mount(folder: Path) -> bool:
    """Say whether a file system can be mounted here."""
    folder.mkdir(parents=True, exist_ok=True)
    if _mount("-t", "tmpfs", "soak", folder).returncode:
        return False
    subprocess.run(["umount", folder], check=True)
    return True


def _mount(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = ["mount", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, check=False)
