"""What models cost, and whether one is better than another."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from addressed_dynamics.base.params.training import EnsembleParams
from addressed_dynamics.reporting.common.blocks import Column
from addressed_dynamics.reporting.common.numbers import MISSING, count
from addressed_dynamics.training.epochs import Length

MARGIN = 1.1
"""One error counts as lower than another if it is so by more than this factor, from every seed."""


Relation = Literal["lower", "higher", "unclear"]


COST_COLUMNS = (Column("parameters"), Column("updates"), Column("samples seen"), Column("multiply-adds a step"))
"""Columns of `cost_cells`."""


COSTS = (
    "Parameters and multiply-adds a step (products with a weight in one prediction) include the addressing network "
    "where one is used; updates and samples seen are those of the predicting networks: an update is one batch for "
    "every network, and a sample counts each time that one of them is given it"
)
"""What a caption says of these columns, without its full stop."""


@dataclass(frozen=True)
class Effort:
    """How long the predicting networks of a candidate were trained."""

    updates: int
    """Updates, each with one batch for every network."""
    samples: int | None
    """Samples that all networks together have seen; None if unknown, as in results of earlier versions."""


def baseline_efforts(baselines: Mapping[str, Mapping[str, float]]) -> dict[str, Effort]:
    """Return how long each baseline was trained, by its name with its seed, from what baselines.json holds."""
    return {
        name: Effort(int(metrics["updates"]), int(metrics["samples"]) if "samples" in metrics else None)
        for name, metrics in baselines.items()
        if "updates" in metrics
    }


def ensemble_effort(recipe: EnsembleParams, samples: int) -> Effort:
    """Return how long an ensemble is trained by its params, on so many samples."""
    length = Length.of(samples, recipe.members, recipe.batch_size, epochs=recipe.epochs)
    return Effort(length.updates, length.samples_after(length.epochs))


def cost_cells(parameters: int, effort: Effort | None, multiply_adds: int | None) -> tuple[str, ...]:
    """Return what a table of candidates shows of the costs of one, in `COST_COLUMNS`."""
    known = (effort.updates, effort.samples) if effort else (None, None)
    return tuple(MISSING if cost is None else count(cost) for cost in (parameters, *known, multiply_adds))


def relate(own: Sequence[float], other: Sequence[float]) -> Relation:
    """Say whether our errors (one per seed) are lower than another's: from every seed, and by more than `MARGIN`."""
    if max(own) * MARGIN < min(other):
        return "lower"
    return "higher" if max(other) * MARGIN < min(own) else "unclear"
