"""Checkpoints: a training that is killed goes on from its last finished epoch, bit for bit.

They lie outside the pipeline's outputs (DVC removes those before a stage runs), under a name made of all that
determines the training, the code's version included, and of nothing that does not: a checkpoint can only ever be found
by the training it belongs to, and another number of processes or one more seed does not lose it.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import safetensors
import safetensors.torch
from safetensors import SafetensorError
from torch import Tensor

from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.versions import hash_sources

FORMAT = 2
"""Version of what a checkpoint holds, part of its name."""
NO_PART = ("processes", "seeds", "variants", "deliver")
"""Params that determine no single training: how many run side by side, which others there are, and which is delivered.
Its own seed and variant are other keys."""
_PACKAGE = Path(__file__).parent.parent
SOURCES = tuple(_PACKAGE / name for name in ("training", "networks", "features", "base/torch_runtime.py"))
"""Folders and files whose code decides what a training gives."""


@dataclass(frozen=True)
class Checkpoint:
    """Where one training keeps its state; `remove` it when the result is written."""

    path: Path
    """The file; it exists once an epoch is finished."""

    @staticmethod
    def of(folder: Path, **identity: Any) -> "Checkpoint":
        """Return the checkpoint in `folder` of the training that `identity` determines, with the code as it is.

        Args:
            folder: where checkpoints lie.
            identity: JSON-compatible values; keys among `NO_PART`, at any depth, are left out.
        """
        text = json.dumps({"format": FORMAT, "code": code_version(), **_decisive(identity)}, sort_keys=True)
        return Checkpoint(folder / f"{hashlib.blake2b(text.encode(), digest_size=12).hexdigest()}.safetensors")

    def save(self, history: list[dict[str, float]], tensors: dict[str, Tensor]) -> None:
        """Keep the metrics of all epochs so far and the state after the last, in place of what was kept before.

        Tensors of any device are kept as those of the CPU, so that a training may go on elsewhere.
        """
        kept = {name: tensor.cpu() for name, tensor in tensors.items()}
        with atomic_path(self.path) as temporary:
            safetensors.torch.save_file(kept, temporary, metadata={"history": json.dumps(history)})

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


@cache
def code_version() -> str:
    """Return a hash of the code that decides what a training gives, as it is when this is first asked."""
    return hash_sources(SOURCES)


def _decisive(value: Any) -> Any:
    """Return a JSON-compatible value without the keys that determine no training."""
    if isinstance(value, dict):
        return {key: _decisive(each) for key, each in value.items() if key not in NO_PART}
    return [_decisive(each) for each in value] if isinstance(value, list | tuple) else value
