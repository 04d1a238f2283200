"""Early stopping: which epoch's networks are kept, and when no better ones are waited for any longer."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Stopping:
    """When a training ends, by the metrics of its epochs so far."""

    epochs: int
    """Epochs that there are at most."""
    patience: int | None
    """Epochs in a row without a lower loss that end it; None: it never ends before its last epoch, which is kept."""
    metric: str
    """The loss, measured on validation samples."""
    first: int = 1
    """The first epoch that may be kept."""

    def kept(self, history: Sequence[dict[str, float]]) -> int:
        """Return the epoch, from 1, that is kept: the last one without patience, else the first of the lowest loss."""
        if self.patience is None or len(history) <= self.first:
            return len(history)
        return min(range(self.first, len(history) + 1), key=lambda epoch: history[epoch - 1][self.metric])

    def ends(self, history: Sequence[dict[str, float]]) -> bool:
        """Whether the epoch that is the last of `history` is the last of the training."""
        waited = len(history) - self.kept(history)
        return len(history) == self.epochs or (self.patience is not None and waited >= self.patience)
