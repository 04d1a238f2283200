"""Files that appear whole or not at all: written under a temporary name, then renamed."""

import csv
import errno
import glob
import json
import os
import platform
import re
import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError

_OS_ERROR = re.compile(r"\(os error (\d+)\)")
"""What safetensors says of an error of the system, as one of its own."""


@contextmanager
def atomic_path(target: Path) -> Iterator[Path]:
    """Yield a temporary path beside `target`; rename it to `target` if the block ends well, remove it otherwise.

    The temporary path may become a file or a folder, whichever the block makes of it. A folder that is replaced is set
    aside first and removed last. So at any moment there is a whole one, under the name of `target` or set aside; if
    this was interrupted in between, the next call for the same target puts back what it finds set aside. It also
    removes what processes of this machine that were killed left under their temporary paths.

    Raises:
        IsADirectoryError: a file would take the place of a folder, whose contents it would cost.
        OSError: the system cannot write, for instance because the disk is full; it names the file, or `target`.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary = target.with_name(f"{_temporary_prefix(target)}{os.getpid()}.partial")
    remove_abandoned(target.parent, glob.escape(target.name))
    _restore(target)
    _remove(temporary)
    try:
        yield temporary
        if target.is_dir():
            if temporary.is_file():
                raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(target))
            target.rename(_set_aside(target))
        temporary.replace(target)
    except OSError as error:
        # A file that is open already, and Parquet's, do not say which one they are.
        if error.filename is None and not hasattr(error, "__notes__"):
            error.add_note(f"while writing {target}")
        raise
    except SafetensorError as error:
        number = _OS_ERROR.search(str(error))
        if number is None:
            raise
        raise OSError(int(number[1]), os.strerror(int(number[1])), str(target)) from error
    finally:
        _restore(target)
        _remove(temporary)


def why_not_file(target: Path) -> str | None:
    """Return why `target` cannot become a file, for an error; None if it can: to be asked before long work for it.

    It is tried, with a file that nobody sees; folders that are not there are not made.
    """
    if target.is_dir():
        return "it is a folder; name a file"
    return why_not_folder(target.parent)


def why_not_folder(folder: Path) -> str | None:
    """Return why nothing can be written into `folder`, which may be to be made; None if something can."""
    there = next(each for each in (folder, *folder.parents) if each.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            return None
    except OSError as error:
        where = "" if there == folder else f"{there}: "
        return f"it cannot be written ({where}{error.strerror})"


def remove_abandoned(folder: Path, names: str = "*") -> None:
    """Remove the temporary paths in `folder` of processes of this machine that have ended.

    Args:
        folder: where they wrote.
        names: what they wrote is called, as a pattern of `glob`.
    """
    for path in folder.glob(f".{names}.{glob.escape(platform.node())}-*.partial"):
        process = path.name.removesuffix(".partial").rpartition("-")[2]
        if process.isdecimal() and not _is_running(int(process)):
            with suppress(FileNotFoundError):  # another process removes it, too
                _remove(path)


def remove_partial(folder: Path) -> None:
    """Remove what `atomic_path` left in a folder, or below, in processes that were killed.

    Nobody may write there any more.
    """
    for path in sorted(folder.rglob(".*.partial")):
        _remove(path)


def write_text(target: Path, text: str) -> None:
    """Write `text` to `target` atomically, in UTF-8."""
    with atomic_path(target) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_json(target: Path, value: Any) -> None:
    """Write `value` to `target` atomically, as indented JSON that ends in a newline.

    Raises:
        ValueError: a number in `value` is NaN or infinite, which JSON cannot hold.
    """
    write_text(target, json.dumps(value, indent=2, allow_nan=False) + "\n")


def save_arrays(target: Path, arrays: dict[str, np.ndarray]) -> None:
    """Write named arrays to `target` atomically, as a compressed .npz whose bytes depend on the arrays alone."""
    with atomic_path(target) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, array in arrays.items():
            # A fixed date: np.savez writes the time of day, and DVC would take equal arrays for new ones.
            entry = zipfile.ZipInfo(f"{name}.npy", date_time=(1980, 1, 1, 0, 0, 0))
            entry.compress_type = zipfile.ZIP_DEFLATED
            with archive.open(entry, "w") as file:
                np.lib.format.write_array(file, np.ascontiguousarray(array), allow_pickle=False)


def _temporary_prefix(target: Path) -> str:
    # Processes of another machine have numbers of their own.
    return f".{target.name}.{platform.node()}-"


def _is_running(process: int) -> bool:
    if os.name == "nt":
        return True  # there, nobody can be asked in this way
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _set_aside(target: Path) -> Path:
    return target.with_name(f".{target.name}.replaced.partial")


def _restore(target: Path) -> None:
    """Put back what was set aside for `target` if nothing has come in its place, and remove it otherwise."""
    aside, discarded = _set_aside(target), target.with_name(f".{target.name}.discarded.partial")
    _remove(discarded)
    if not _is_there(aside):
        return
    if _is_there(target):
        # Under a name of its own while it is removed: what is found set aside is always whole.
        aside.rename(discarded)
        _remove(discarded)
    else:
        aside.rename(target)


def _is_there(path: Path) -> bool:
    return path.is_symlink() or path.exists()


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def write_rows(path: Path, rows: list[dict[str, Any]]) -> None:
    """Write rows as CSV; a column is empty where a row does not have it."""
    columns = dict.fromkeys(key for row in rows for key in row)
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(columns), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
