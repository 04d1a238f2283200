"""What networks are trained on, and how it was made."""

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

from torch import Tensor

from addressed_dynamics.features.common.augmentation import Augment
from addressed_dynamics.features.common.samples import Dropped, Samples, Windows, fingerprint
from addressed_dynamics.features.common.spool import release


class AnyFeatures(Protocol):
    """What a kind's features are to everything that knows no kind."""

    @property
    def inputs(self) -> int:
        """Number of a network's inputs."""
        ...

    @property
    def outputs(self) -> int:
        """Number of a network's outputs."""
        ...

    def loss_unit(self, loss: Any, /) -> float:
        """Return by what a loss of normalised outputs is multiplied to be in the unit that is reported."""
        ...

    def to_json(self) -> dict[str, Any]:
        """Return the features as JSON-compatible values, from which they are made again."""
        ...


Features = TypeVar("Features", bound=AnyFeatures)


@dataclass(frozen=True)
class Choice:
    """A number that params left to validation, with what it was chosen by."""

    chosen: int
    """The number."""
    tried: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """What each number reached, the lower the better in the first figure; empty if there was nothing to choose."""


@dataclass(frozen=True)
class TrainingData(Generic[Features]):
    """The samples of an experiment, and how they were made."""

    features: Features
    """Normalisation and targets, from the training split alone."""
    train: Samples
    """Samples to train on."""
    validation: Samples
    """Samples to choose by."""
    augment: Augment | None = None
    """What is done to batches before a network sees them; None for nothing."""
    phases: tuple[Tensor, Tensor] | None = field(default=None)
    """Phase of each training and of each validation sample, in [0, 1], if the data have phases."""
    dropped: Mapping[str, Dropped] = field(default_factory=dict)
    """What no sample is of, for want of frames, by split; empty where a sample is of one frame by its kind."""

    choices: Mapping[str, Choice] = field(default_factory=dict)
    """What params of the features left to validation, by the name of the key."""
    persistence: tuple[Tensor, Tensor] | None = None
    """Weights (input, output) and biases of the linear map by which nothing changes; None if the kind has references of
    its own."""
    last_change: tuple[Tensor, Tensor] | None = None
    """The same of the linear map by which the last change goes on; None if inputs are of one frame."""
    last_frame: int | None = None
    """Number of inputs that are of the last frame, the last ones; None if all of them are."""

    spools: tuple[Path, ...] = ()
    """Folders of the samples that are larger than memory; `discard` them when what is trained is written."""

    def discard(self) -> None:
        """Remove the files of samples that are larger than memory, if there are any."""
        for folder in self.spools:
            shutil.rmtree(folder, ignore_errors=True)

    @cached_property
    def fingerprint(self) -> str:
        """A hash of everything that a training may see."""
        found = fingerprint(*self.tensors)
        release(*self.tensors)
        return found

    @property
    def tensors(self) -> tuple[Tensor | Windows, ...]:
        """Everything a training may see."""
        return self.train.x, self.train.y, self.validation.x, self.validation.y
