"""What evaluations of any kind of data find, as it is written and read."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Base of what is read from JSON: frozen; keys that a report does not show are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class MeanLosses(Record):
    """Mean loss of each member (Fig. 9)."""

    all: tuple[float, ...]
    """Over all samples."""
    own: tuple[float | None, ...]
    """Over those for which it is selected; None if there are none."""


class Specialisation(Record):
    """How the members share the samples of one split."""

    samples: int
    agreement: float
    lowest_loss: tuple[int, ...]
    """Samples on which each member has the lowest loss (Fig. 8)."""
    addressed: tuple[int, ...]
    """Samples for which each member is selected."""
    mean_loss: MeanLosses
    loss_edges: tuple[float, ...]
    """Bounds of the intervals of losses (Fig. 10)."""
    loss_counts: tuple[tuple[int, ...], ...]
    """Each member's own losses by interval."""
    output_edges: tuple[float, ...]
    """Bounds of the intervals of the addressing outputs (Fig. 11)."""
    output_counts: tuple[tuple[int, ...], ...]
    """Each member's addressing output over all samples by interval."""


class Specialisations(Record):
    """The same for the samples that the delivered model has learned from, and for held-out episodes."""

    train: Specialisation
    test: Specialisation


class BaselineLosses(Record):
    """Mean losses of single networks by their names such as `wide/seed-0`, beside those of Fig. 9."""

    train: dict[str, float]
    test: dict[str, float]


class Dropped(Record):
    """Episodes that are left out because they are too short."""

    episodes: int = 0
    rows: int = 0
