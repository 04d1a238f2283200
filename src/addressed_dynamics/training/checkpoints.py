"""Checkpoints: a training that is killed goes on from its last finished epoch, bit for bit.

They lie outside the pipeline's outputs (DVC removes those before a stage runs), under a name made of all that
determines the training, so that a checkpoint can only ever be found by the training it belongs to.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from safetensors import SafetensorError
from torch import Tensor

from addressed_dynamics.base.files import atomic_path

FORMAT = 2
"""Version of what a checkpoint holds, part of its name."""


@dataclass(frozen=True)
class Checkpoint:
    """Where one training keeps its state; `remove` it when the result is written."""

    path: Path
    """The file; it exists once an epoch is finished."""

    @staticmethod
    def of(folder: Path, **identity: Any) -> "Checkpoint":
        """Return the checkpoint in `folder` of the training that `identity` (JSON-compatible values) determines."""
        text = json.dumps({"format": FORMAT, **identity}, sort_keys=True)
        return Checkpoint(folder / f"{hashlib.blake2b(text.encode(), digest_size=12).hexdigest()}.safetensors")

    def save(self, history: list[dict[str, float]], tensors: dict[str, Tensor]) -> None:
        """Keep the metrics of all epochs so far and the state after the last, in place of what was kept before."""
        with atomic_path(self.path) as temporary:
            safetensors.torch.save_file(tensors, temporary, metadata={"history": json.dumps(history)})

    def load(self) -> tuple[list[dict[str, float]], dict[str, Tensor]]:
        """Return the metrics of the finished epochs and the state after the last; nothing if none can be read."""
        try:
            with safetensors.safe_open(self.path, framework="pt") as file:
                history: list[dict[str, float]] = json.loads(file.metadata()["history"])
                return history, {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 - not a mapping
        except (FileNotFoundError, SafetensorError):
            return [], {}

    def remove(self) -> None:
        """Delete the file, if there is one."""
        self.path.unlink(missing_ok=True)
