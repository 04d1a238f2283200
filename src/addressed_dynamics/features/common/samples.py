"""What training sees: inputs, targets and where they come from."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import final

import torch
from jaxtyping import Float, Int, Int64
from torch import Tensor

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.features.common.courses import Courses


@dataclass(frozen=True)
class Dropped:
    """What of the data is left out, because its episodes are too short for what they are to be used for."""

    episodes: int = 0
    """Number of episodes."""
    rows: int = 0
    """Number of their rows."""


BLOCK_ROWS = 8192
"""Samples that are put together at once where all are looked at."""


@final
@dataclass(frozen=True)
class Windows:
    """Inputs that are consecutive frames side by side, put together when they are asked for.

    Like a tensor (sample, input) as far as training reads one. Each frame is kept once, and not in every window that it
    is part of.
    """

    frames: Float[Tensor, "row column"]
    """Normalised frames of all rows; contiguous."""
    last: Int[Tensor, " sample"]
    """The last row of each window; the others are those just before it."""
    weights: Float[Tensor, "frame 1"]
    """By what each frame of a window is multiplied, oldest first."""

    @property
    def shape(self) -> tuple[int, int]:
        """Number of samples, and of inputs."""
        return len(self.last), len(self.weights) * self.frames.shape[1]

    @property
    def ndim(self) -> int:
        """Number of dimensions: 2."""
        return len(self.shape)

    def __len__(self) -> int:
        return len(self.last)

    @property
    def device(self) -> torch.device:
        """Where they are put together."""
        return self.frames.device

    def to(self, device: torch.device) -> "Windows":
        """Return the same on a device."""
        return Windows(self.frames.to(device), self.last.to(device), self.weights.to(device))

    def __getitem__(self, samples: Int64[Tensor, "*batch"] | slice) -> Float[Tensor, "*batch input"]:
        """Return the inputs of these samples."""
        (rows, columns), history = self.frames.shape, len(self.weights)
        # The windows as overlapping rows of the same memory: to gather these is as fast as if each had its own.
        windows = self.frames.as_strided((max(rows - history + 1, 0), history * columns), (columns, 1))
        found = windows[self.last[samples] - (history - 1)]
        return (found.view(*found.shape[:-1], history, columns) * self.weights).flatten(start_dim=-2)


@dataclass(frozen=True)
class Samples:
    """Inputs and targets of a network, normalised, float32, one row a sample. Validated on construction."""

    x: Float[Tensor, "sample input"] | Windows
    """Normalised state and action."""
    y: Float[Tensor, "sample output"]
    """Normalised target."""
    episode: Int[Tensor, " sample"]
    """The episode the sample was taken from."""
    step: Int[Tensor, " sample"]
    """The step in that episode."""
    courses: Courses | None = None
    """How it goes on after each sample; None if nobody asked, or networks cannot go on from what they predict."""

    def __post_init__(self) -> None:
        lengths = {len(self.x), len(self.y), len(self.episode), len(self.step)}
        if self.x.ndim != 2 or self.y.ndim != 2 or len(lengths) != 1:
            message = f"samples need x and y of two dimensions and equal lengths, but have lengths {sorted(lengths)}"
            raise TransitionsError(message)
        x = self.x.frames if isinstance(self.x, Windows) else self.x
        if not all(bool(torch.isfinite(block).all()) for values in (x, self.y) for block in _blocks(values)):
            message = "samples hold a value that is not finite"
            raise TransitionsError(message)

    def __len__(self) -> int:
        return len(self.x)

    @property
    def device(self) -> torch.device:
        """Where they are."""
        return self.y.device

    def to(self, device: torch.device) -> "Samples":
        """Return the same on a device: themselves if that is where they are."""
        if self.device == device:
            return self
        courses = None if self.courses is None else self.courses.to(device)
        return Samples(self.x.to(device), self.y.to(device), self.episode.to(device), self.step.to(device), courses)

    def first(self, rows: int) -> "Samples":
        """Return the first samples, at most `rows` of them."""
        part = slice(rows)
        return Samples(self.x[part], self.y[part], self.episode[part], self.step[part], self.courses)

    def fingerprint(self) -> str:
        """Return a hash of the inputs and targets, to tell whether a checkpoint belongs to them."""
        return fingerprint(self.x, self.y)


def fingerprint(*tensors: Tensor | Windows) -> str:
    """Return a hash of the shapes and values of `tensors`; windows count as the tensor that they stand for."""
    digest = hashlib.blake2b(digest_size=16)
    for tensor in tensors:
        digest.update(str(tuple(tensor.shape)).encode())
        for block in _blocks(tensor):
            digest.update(block.contiguous().numpy().data)
    return digest.hexdigest()


def _blocks(values: Tensor | Windows) -> Iterator[Float[Tensor, "sample ..."]]:
    for first in range(0, len(values), BLOCK_ROWS):
        yield values[first : first + BLOCK_ROWS]
