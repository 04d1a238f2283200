"""What training sees: inputs, targets and where they come from."""

import hashlib
from dataclasses import dataclass

import torch
from jaxtyping import Float, Int64
from torch import Tensor

from addressed_dynamics.base.errors import TransitionsError


@dataclass(frozen=True)
class Dropped:
    """What of the data is left out, because its episodes are too short for what they are to be used for."""

    episodes: int = 0
    """Number of episodes."""
    rows: int = 0
    """Number of their rows."""


@dataclass(frozen=True)
class Samples:
    """Inputs and targets of a network, normalised, float32, one row a sample. Validated on construction."""

    x: Float[Tensor, "sample input"]
    """Normalised state and action."""
    y: Float[Tensor, "sample output"]
    """Normalised target."""
    episode: Int64[Tensor, " sample"]
    """The episode the sample was taken from."""
    step: Int64[Tensor, " sample"]
    """The step in that episode."""

    def __post_init__(self) -> None:
        lengths = {len(self.x), len(self.y), len(self.episode), len(self.step)}
        if self.x.ndim != 2 or self.y.ndim != 2 or len(lengths) != 1:
            message = f"samples need x and y of two dimensions and equal lengths, but have lengths {sorted(lengths)}"
            raise TransitionsError(message)
        if not (torch.isfinite(self.x).all() and torch.isfinite(self.y).all()):
            message = "samples hold a value that is not finite"
            raise TransitionsError(message)

    def __len__(self) -> int:
        return len(self.x)

    def fingerprint(self) -> str:
        """Return a hash of the inputs and targets, to tell whether a checkpoint belongs to them."""
        return fingerprint(self.x, self.y)


def fingerprint(*tensors: Tensor) -> str:
    """Return a hash of the shapes and values of `tensors`."""
    digest = hashlib.blake2b(digest_size=16)
    for tensor in tensors:
        digest.update(str(tuple(tensor.shape)).encode())
        digest.update(tensor.contiguous().numpy().data)
    return digest.hexdigest()
