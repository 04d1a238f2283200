"""Checkpoints: a training that is killed goes on from its last finished epoch, bit for bit.

They lie outside the pipeline's outputs (DVC removes those before a stage runs), under a name made of all that
determines the training, so that a checkpoint can only ever be found by the training it belongs to.
"""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import safetensors.torch
import torch
from safetensors import SafetensorError
from torch import Tensor

from addressed_dynamics.files import atomic_path


@dataclass(frozen=True)
class Checkpoint:
    """Where one training keeps its state; `remove` it when the result is written."""

    path: Path
    """The file; it exists once an epoch is finished."""

    @staticmethod
    def of(folder: Path, **identity: Any) -> "Checkpoint":
        """Return the checkpoint in `folder` of the training that `identity` (JSON-compatible values) determines."""
        text = json.dumps(identity, sort_keys=True)
        return Checkpoint(folder / f"{hashlib.blake2b(text.encode(), digest_size=12).hexdigest()}.safetensors")

    def save(self, epoch: int, tensors: dict[str, Tensor]) -> None:
        """Keep `tensors` as the state after `epoch`; the previous state is replaced in one step."""
        with atomic_path(self.path) as temporary:
            safetensors.torch.save_file({**tensors, "epoch": torch.tensor(epoch)}, temporary)

    def load(self) -> tuple[int, dict[str, Tensor]]:
        """Return the last saved epoch and its tensors; 0 and nothing if there is none that can be read."""
        try:
            tensors = safetensors.torch.load_file(self.path)
        except (FileNotFoundError, SafetensorError):
            return 0, {}
        return int(tensors.pop("epoch")), tensors

    def remove(self) -> None:
        """Delete the file, if there is one."""
        self.path.unlink(missing_ok=True)
