"""Tables of candidates: what each model costs, beside what a kind measures of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.reporting.common.blocks import Column, Row
from addressed_dynamics.reporting.common.numbers import MISSING, count
from addressed_dynamics.simulators.delivery import ENSEMBLE
from addressed_dynamics.training.epochs import Length

COSTS = (
    "Parameters and multiply-adds a step (products with a weight in one prediction) include the addressing network "
    "where one is used; updates and samples seen are those of the predicting networks: an update is one batch for "
    "every network, and a sample counts each time that one of them is given it"
)
"""What a caption says of the columns of costs, without its full stop."""

_COST_COLUMNS = (Column("parameters"), Column("updates"), Column("samples seen"), Column("multiply-adds a step"))


@dataclass(frozen=True)
class Effort:
    """How long the predicting networks of a candidate were trained."""

    updates: int
    """Updates, each with one batch for every network."""
    samples: int | None
    """Samples that all networks together have seen; None if unknown, as in results of earlier versions."""


class Candidate(Protocol):
    """What every kind knows of a candidate."""

    @property
    def label(self) -> str:
        """What a reader should see for it."""

    @property
    def parameters(self) -> int:
        """Its parameters."""

    @property
    def multiply_adds(self) -> int | None:
        """Products with a weight in one prediction; None if unknown."""


def efforts_of(
    baselines: Mapping[str, Mapping[str, float]], ensemble: EnsembleParams, samples: int | None
) -> dict[str, Effort]:
    """Return how long each baseline was trained, by its name with its seed, and the ensemble as `ensemble`.

    Args:
        baselines: what baselines.json holds; those without updates were not trained by epochs, and are left out.
        ensemble: how the ensemble was trained.
        samples: how many it was trained on; None if unknown, and then it is left out.
    """
    efforts = {
        name: Effort(int(metrics["updates"]), int(metrics["samples"]) if "samples" in metrics else None)
        for name, metrics in baselines.items()
        if "updates" in metrics
    }
    return efforts if samples is None else efforts | {ENSEMBLE: ensemble_effort(ensemble, samples)}


def ensemble_effort(recipe: EnsembleParams, samples: int) -> Effort:
    """Return how long an ensemble is trained by its params, on so many samples."""
    length = Length.of(samples, recipe.members, recipe.batch_size, epochs=recipe.epochs)
    return Effort(length.updates, length.samples_after(length.epochs))


def effort_of(efforts: Mapping[str, Effort], name: str) -> Effort | None:
    """Return that of a candidate by its name; every way to use the ensemble has the ensemble's."""
    return efforts.get(ENSEMBLE if name.startswith(f"{ENSEMBLE}/") else name)


def candidate_columns(*measured: Column) -> tuple[Column, ...]:
    """Return the columns of a table of candidates, of which the last are those that a kind has measured."""
    return (Column("Model", numeric=False), *_COST_COLUMNS, *measured)


def candidate_row(
    candidate: Candidate, effort: Effort | None, measured: Iterable[str], kind: str, *, title: str = ""
) -> Row:
    """Return the row of a candidate.

    Args:
        candidate: what it is about.
        effort: how long it was trained; None if unknown, or if it was not trained by epochs.
        measured: what a kind has measured.
        kind: how the row stands out, see `Row.kind`.
        title: what a reader should see for it; empty for its label.
    """
    updates, samples = (effort.updates, effort.samples) if effort else (None, None)
    costs = (candidate.parameters, updates, samples, candidate.multiply_adds)
    cells = (MISSING if cost is None else count(cost) for cost in costs)
    return Row((title or candidate.label, *cells, *measured), kind)


def costless_row(title: str, measured: Iterable[str], kind: str, blank: str = "") -> Row:
    """Return the row of what is no candidate, with `blank` in place of its costs."""
    return Row((title, *[blank] * len(_COST_COLUMNS), *measured), kind)
