"""Files that appear whole or not at all: also where a folder is replaced, and whenever that is interrupted."""

import errno
import os
import platform
import resource
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.numpy

from addressed_dynamics.base.files import atomic_path, remove_partial, write_text

OLD, NEW = {"a.txt": "old", "b.txt": "old"}, {"a.txt": "new", "c.txt": "new"}


class Killed(BaseException):
    """The end of the process: from here on, nothing that touches a file works."""


def fill(folder: Path, files: dict[str, str]) -> None:
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)


def found(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def replace_folder(target: Path) -> None:
    with atomic_path(target) as temporary:
        fill(temporary, NEW)


def test_no_file_takes_the_place_of_a_folder(tmp_path: Path) -> None:
    fill(tmp_path / "data", OLD)
    with pytest.raises(IsADirectoryError, match="data"):
        write_text(tmp_path / "data", "page")
    assert found(tmp_path / "data") == OLD
    assert [each.name for each in tmp_path.iterdir()] == ["data"]


def die_at(step: int, patches: pytest.MonkeyPatch) -> None:
    """Let the process die at a step, the first being 0: a rename, or the removal of a file."""
    steps = iter(range(step))

    def dying(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(*arguments: Any, **options: Any) -> Any:
            if next(steps, None) is None:
                raise Killed
            return function(*arguments, **options)

        return call

    def remove(folder: Path) -> None:
        for file in sorted(folder.iterdir()):
            file.unlink()
        folder.rmdir()

    for name in ("rename", "replace", "unlink"):
        patches.setattr(Path, name, dying(getattr(Path, name)))
    patches.setattr(shutil, "rmtree", remove)


def replace_and_die_at(step: int, target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fill(target, OLD)
    with monkeypatch.context() as patches, suppress(Killed):
        die_at(step, patches)
        replace_folder(target)


@pytest.mark.parametrize("step", range(12))
def test_a_replaced_folder_is_whole_under_its_name_or_set_aside_wherever_the_process_dies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    target = tmp_path / "tables"
    replace_and_die_at(step, target, monkeypatch)
    wholes = [found(each) for each in tmp_path.iterdir() if each.is_dir()]
    assert found(target) in (OLD, NEW) if target.exists() else OLD in wholes
    with suppress(ZeroDivisionError), atomic_path(target):
        # The next call finds it again, even if it comes to nothing.
        assert found(target) in (OLD, NEW)
        raise ZeroDivisionError
    assert found(target) in (OLD, NEW)
    replace_folder(target)
    assert found(target) == NEW
    assert [path.name for path in tmp_path.iterdir()] == ["tables"]


def test_a_new_folder_that_cannot_take_its_name_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "tables"
    fill(target, OLD)

    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Path, "replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        replace_folder(target)
    assert found(target) == OLD
    assert [path.name for path in tmp_path.iterdir()] == ["tables"]


@pytest.mark.parametrize("step", range(12))
def test_what_was_set_aside_never_comes_back_half_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    target = tmp_path / "tables"
    replace_and_die_at(step, target, monkeypatch)
    shutil.rmtree(target, ignore_errors=True)  # as DVC does before it runs a stage again
    with suppress(ZeroDivisionError), atomic_path(target):
        raise ZeroDivisionError
    assert not target.exists() or found(target) == OLD


def test_what_a_killed_process_left_half_written_goes_with_the_next_call_and_nothing_else_does(tmp_path: Path) -> None:
    target = tmp_path / "tables"
    killed = subprocess.Popen(["sleep", "60"])
    left, others = f".tables.{platform.node()}-{killed.pid}.partial", [
        f".tables.{platform.node()}-{os.getppid()}.partial",  # which runs
        f".tables.elsewhere-{killed.pid}.partial",
        f".tables2.{platform.node()}-{killed.pid}.partial",
    ]  # fmt: skip
    for name in (left, *others):
        fill(tmp_path / name, OLD)
    replace_folder(target)
    assert (tmp_path / left).exists()
    killed.kill()
    killed.wait()
    replace_folder(target)
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["tables", *others])


@pytest.fixture
def small_files() -> Iterator[None]:
    """A limit to the size of files, which any program may set: what a full disk says, but for the words."""
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, limits)


def save_tensors(path: Path) -> None:
    safetensors.numpy.save_file({"weights": np.zeros(9999)}, path)


def write_bytes(path: Path) -> None:
    with path.open("wb") as file:
        file.write(bytes(9999))


@pytest.mark.usefixtures("small_files")
@pytest.mark.parametrize("write", [save_tensors, write_bytes])
def test_what_cannot_be_written_is_an_error_of_the_system_that_says_where(
    tmp_path: Path, write: Callable[[Path], None]
) -> None:
    with pytest.raises(OSError, match="File too large") as caught, atomic_path(tmp_path / "model") as temporary:
        write(temporary)
    assert caught.value.errno == errno.EFBIG
    assert f"{tmp_path / 'model'}" in "; ".join([str(caught.value), *getattr(caught.value, "__notes__", [])])
    assert list(tmp_path.iterdir()) == []


def test_what_killed_processes_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    tables = tmp_path / "tables"
    fill(tables, OLD)
    (tables / "train").mkdir()
    fill(tables / "train" / ".0003.17.partial", NEW)
    (tables / "train" / ".a.parquet.17.partial").touch()
    (tables / ".left.replaced.partial").symlink_to(tmp_path)
    remove_partial(tables)
    remove_partial(tmp_path / "nowhere")
    assert sorted(path.name for path in tables.rglob("*")) == ["a.txt", "b.txt", "train"]
    assert tmp_path.exists()
