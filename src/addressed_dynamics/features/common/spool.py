"""Samples that are larger than memory: written once to files, which are mapped, so that trainings read them as tensors.

What is computed does not depend on where samples lie. A spool is named by all that determines it, and appears whole or
not at all; a training that was killed finds it again.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import shutil
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Protocol, final
from weakref import WeakSet

import numpy as np
import torch
from torch import Tensor

from addressed_dynamics.base.errors import TrainingError
from addressed_dynamics.base.files import atomic_path, remove_abandoned, write_json
from addressed_dynamics.base.memory import MEMORY
from addressed_dynamics.features.common.samples import Samples, Windows

INDEX = "columns.json"
"""What the files of a spool hold."""
KINDS = (torch.float32, torch.float64, torch.uint8, torch.int32, torch.int64, torch.bool)
"""Types that columns may have."""
_DTYPES = {str(each).removeprefix("torch."): each for each in KINDS}


@final
class Mapped(Tensor):
    """A tensor that lies in a file. Processes that it is given to map the same file; what is taken of it is in memory.

    Make one with `map_file`.
    """

    # What is computed of it is a plain tensor.
    __torch_function__ = torch._C._disabled_torch_function_impl  # type: ignore[assignment] # torch's own way

    path: Path
    """The file."""
    _memory: mmap.mmap

    def __reduce_ex__(self, _protocol: Any) -> tuple[Any, ...]:
        return map_file, (self.path, str(self.dtype).removeprefix("torch."), tuple(self.shape))

    def release(self) -> None:
        """Let this process's hold on the pages of the file go; they are found again when they are next read."""
        self._memory.madvise(mmap.MADV_DONTNEED)


def map_file(path: Path, dtype: str, shape: tuple[int, ...]) -> Tensor:
    """Return a file as a tensor; what is written to it is written to the file.

    Raises:
        TrainingError: the file is not there, or has not as many bytes.
    """
    size = math.prod(shape) * _DTYPES[dtype].itemsize
    if not size:
        return torch.empty(shape, dtype=_DTYPES[dtype])
    try:
        with path.open("r+b") as file:
            found = os.fstat(file.fileno()).st_size
            if found != size:
                message = (
                    f"{path} should have {size} bytes of samples, but has {found}; remove its folder and run again"
                )
                raise TrainingError(message)
            return _map(file, path, dtype, shape)
    except OSError as error:
        message = (
            f"{socket.gethostname()} cannot read {path} ({error.strerror}), where samples lie that memory does not "
            f"hold: all workers have to see this file; with a larger {MEMORY} they are sent to them"
        )
        raise TrainingError(message) from error


def release(*values: Tensor | Windows) -> None:
    """Let the hold on the pages go of what is mapped; see `Mapped.release`."""
    for value in values:
        if isinstance(value, Windows):
            release(value.frames, value.last)
        elif isinstance(value, Mapped):
            value.release()


def beside(samples: Samples, name: str | None = None) -> Callable[..., Tensor]:
    """Return what makes empty tensors (shape, dtype=) that are as large as samples: in memory, if these are there.

    Otherwise they lie in a file beside the samples. Without a name nobody else finds it, and it goes with the tensor.
    """
    x = samples.x.frames if isinstance(samples.x, Windows) else samples.x
    return partial(_scratch, x.path.parent, name) if isinstance(x, Mapped) else torch.empty


BLOCK_ROWS = 2**16
"""Rows that are looked at together where no network is evaluated."""
BLOCKS_HELD = 16
"""After so many such blocks, pages of files are let go."""


@final
class Scratch:
    """Where arrays with a number for each of many rows lie: in memory, or in files that go with the arrays.

    The files have no name, so that nothing is left of them, however this process ends.

    Args:
        folder: of the files; it is made when the first one is. None for memory.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._made = WeakSet[mmap.mmap]()

    def __call__(self, shape: int | tuple[int, ...], dtype: torch.dtype = torch.float32, **options: Any) -> Tensor:
        """Return an empty tensor.

        Raises:
            TrainingError: it does not fit on the disk.
        """
        if self._folder is None:
            return torch.empty(shape, dtype=dtype, **options)
        self._folder.mkdir(parents=True, exist_ok=True)
        made = _scratch(self._folder, None, shape, dtype)
        if isinstance(made, Mapped):
            self._made.add(made._memory)
        return made

    def array(self, shape: int | tuple[int, ...], dtype: torch.dtype = torch.float64) -> np.ndarray:
        """Return an empty array; otherwise the same."""
        return self(shape, dtype).numpy()

    def like(self, shape: tuple[int, ...], dtype: Any) -> np.ndarray:
        """Return an empty array of a data type of NumPy's."""
        return self.array(shape, torch.from_numpy(np.empty(0, dtype)).dtype)

    def filled(self, count: int, function: Callable[[slice], np.ndarray]) -> np.ndarray:
        """Return an array with a row for each of so many, made block by block."""
        found: np.ndarray | None = None
        for rows in self.blocks(count):
            part = function(rows)
            if found is None:
                found = self.like((count, *part.shape[1:]), part.dtype)
            found[rows] = part
        return function(slice(0)) if found is None else found

    def selected(self, values: np.ndarray, chosen: Callable[[slice], np.ndarray]) -> np.ndarray:
        """Return a copy of the rows of an array that a function chooses, which returns a mask for some of them."""
        count = sum(int(np.count_nonzero(chosen(rows))) for rows in self.blocks(len(values)))
        found, stop = self.like((count, *values.shape[1:]), values.dtype), 0
        for rows in self.blocks(len(values)):
            part = values[rows][chosen(rows)]
            found[stop : stop + len(part)] = part
            stop += len(part)
        return found

    def blocks(self, count: int) -> Iterator[slice]:
        """Yield so many rows, block by block; pages of files are let go meanwhile."""
        for number, first in enumerate(range(0, count, BLOCK_ROWS), start=1):
            yield slice(first, min(first + BLOCK_ROWS, count))
            if not number % BLOCKS_HELD:
                self.release()
        self.release()

    def release(self) -> None:
        """Let this process's hold on the pages of all files go; they are found again when they are next read."""
        for memory in self._made:
            memory.madvise(mmap.MADV_DONTNEED)


IN_MEMORY = Scratch()
"""Where arrays lie if nothing else is said."""


def _scratch(
    folder: Path, name: str | None, shape: int | tuple[int, ...], dtype: torch.dtype = torch.float32, **_: Any
) -> Tensor:
    shape, kind = ((shape,) if isinstance(shape, int) else tuple(shape)), str(dtype).removeprefix("torch.")
    size = math.prod(shape) * dtype.itemsize
    if not size:
        return torch.empty(shape, dtype=dtype)
    path = folder / f"{name}.bin"
    try:
        with tempfile.TemporaryFile(dir=folder) if name is None else path.open("w+b") as file:
            _reserve(file, size)
            return _map(file, path, kind, shape)
    except OSError as error:
        if name is not None:
            path.unlink(missing_ok=True)
        raise _no_room(folder, size, error) from error


def _reserve(file: Any, size: int) -> None:
    """Take the room on the disk now: a mapped file that meets a full disk later kills the process."""
    if sys.platform == "linux":
        os.posix_fallocate(file.fileno(), 0, size)
        return
    block = bytes(2**20)
    for first in range(0, size, len(block)):
        file.write(block[: size - first])
    file.flush()


def _map(file: Any, path: Path, dtype: str, shape: tuple[int, ...]) -> Mapped:
    memory = mmap.mmap(file.fileno(), 0)
    mapped = torch.frombuffer(memory, dtype=_DTYPES[dtype]).view(shape).as_subclass(Mapped)
    mapped.path, mapped._memory = path, memory
    return mapped


class Sink(Protocol):
    """Where columns go, part by part."""

    def add(self, **columns: Tensor) -> None:
        """Add rows at the end of columns."""


class InMemory:
    """Columns that stay in memory."""

    def __init__(self) -> None:
        self._parts: dict[str, list[Tensor]] = {}

    def add(self, **columns: Tensor) -> None:
        """Add rows at the end of columns."""
        for name, rows in columns.items():
            self._parts.setdefault(name, []).append(rows)

    def columns(self) -> dict[str, Tensor]:
        """Return the columns; they are no longer here then."""
        return {name: parts[0] if len(parts) == 1 else torch.cat(parts) for name, parts in _emptied(self._parts)}


def _emptied(parts: dict[str, list[Tensor]]) -> Any:
    while parts:
        name = next(iter(parts))
        yield name, parts.pop(name)


class _OnDisk:
    """Columns that are written to a folder, a file each."""

    def __init__(self, folder: Path, files: ExitStack) -> None:
        self._folder, self._files = folder, files
        self._open: dict[str, BinaryIO] = {}
        self._index: dict[str, dict[str, Any]] = {}

    def add(self, **columns: Tensor) -> None:
        for name, rows in columns.items():
            if name not in self._open:
                self._open[name] = self._files.enter_context((self._folder / f"{name}.bin").open("wb"))
                self._index[name] = {"dtype": str(rows.dtype).removeprefix("torch."), "shape": [0, *rows.shape[1:]]}
            self._open[name].write(rows.contiguous().numpy().data)
            self._index[name]["shape"][0] += len(rows)

    def close(self) -> None:
        for file in self._open.values():
            file.flush()
            os.fsync(file.fileno())
        write_json(self._folder / INDEX, self._index)


@dataclass(frozen=True)
class Spool:
    """Where samples go that are larger than memory."""

    folder: Path
    """Folder of the spools, outside of what the pipeline delivers."""
    memory: int
    """Bytes of samples that memory holds."""

    def scratch(self, size: int) -> Scratch:
        """Return where arrays with so many bytes together lie."""
        return IN_MEMORY if size <= self.memory else Scratch(self.folder)

    def columns(self, name: str, size: int, write: Callable[[Sink], None]) -> tuple[dict[str, Tensor], Path]:
        """Return columns, mapped, and their folder; they are written if they are not there.

        Args:
            name: made of all that determines them.
            size: about how many bytes they have.
            write: adds them to a sink.

        Raises:
            TrainingError: they do not fit on the disk.
        """
        folder = self.folder / f"spool-{name}"
        remove_abandoned(self.folder)
        if not folder.is_dir():
            self.folder.mkdir(parents=True, exist_ok=True)
            if (free := shutil.disk_usage(self.folder).free) < size:
                raise _no_room(self.folder, size, f"{free / 1e9:.1f} GB are free")
            try:
                with atomic_path(folder) as temporary, ExitStack() as files:
                    temporary.mkdir()
                    sink = _OnDisk(temporary, files)
                    write(sink)
                    sink.close()
            except OSError as error:
                raise _no_room(self.folder, size, error) from error
        index: Mapping[str, Any] = json.loads((folder / INDEX).read_text(encoding="utf-8"))
        return {
            key: map_file(folder / f"{key}.bin", about["dtype"], tuple(about["shape"])) for key, about in index.items()
        }, folder


def _no_room(folder: Path, size: int, reason: OSError | str) -> TrainingError:
    why = reason if isinstance(reason, str) else reason.strerror
    return TrainingError(
        f"{folder}: {size / 1e9:.1f} GB of samples that memory does not hold cannot be written there ({why}); make "
        f"room, or let {MEMORY} be larger"
    )
