"""What the evaluation finds of a model's trust: `trust` in evaluation.json. Every part may be missing."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from addressed_dynamics.evaluation.common.records import Record


class CoverageRecord(Record):
    """How much of the truth lies in the intervals of one coverage, so many steps ahead."""

    steps: int
    """Of a model's own predictions, from a true state."""
    asked: float
    """The share that the intervals are asked to cover."""
    of_all: float
    """The share that they do cover, over all dimensions; every episode counts as much as any other."""
    standard_error: float | None = None
    """Of `of_all`, over the episodes; None of a single one."""
    dimensions: dict[str, float] = Field(default_factory=dict)
    """The same of each dimension."""
    points: int | None = None
    """Predictions that this was counted over."""
    episodes: int | None = None
    """Episodes that these are of."""


class ShiftRecord(Record):
    """How well scores tell bad predictions from good ones, among those under a shift and those on test episodes."""

    kind: Literal["starts", "behaviour", "mechanics"]
    auroc: dict[str, float | None] = Field(default_factory=dict)
    """By score: `trust`, `surprise`, and `spread`, `distance`, `unlikeness` and `margin` alone; None where nothing can
    be counted over, or all errors are the same."""
    positive_share: float | None = None
    """Share of the predictions under the shift whose errors are above the 99th percentile of validation errors."""
    bad: Literal["validation", "worst"] = "validation"
    """What was to be told from the others: errors above the 99th percentile of validation errors, or, where all are
    above it or none is, above that of the predictions under the shift and on test episodes themselves."""


class RiskRecord(Record):
    """The mean error of the predictions that are trusted most, at one coverage."""

    coverage: float
    risk: float
    oracle: float
    """The same in the best order."""


class PlaceRecord(Record):
    """Some steps in a row in which large errors are expected."""

    episode: int
    step: int
    """The first of them."""
    steps: int
    expected_percent: float
    """Root mean square of the errors that are expected one step ahead, in % of the range."""
    error_percent: float
    """The same of those that were made."""
    trust: float
    """Mean over the steps."""
    state: dict[str, float]
    """Mean over the steps, by dimension, in its unit."""


class TrustRecord(Record):
    """All that was measured of a model's trust."""

    model: str | None = None
    """Which of the experiment's models it is."""
    episodes: int | None = None
    """Validation episodes that it was calibrated on."""
    places: tuple[PlaceRecord, ...] = ()
    """Where in validation and test episodes more data would help most, the largest expected error first."""

    coverage: tuple[CoverageRecord, ...] = ()
    shifts: dict[str, ShiftRecord] = Field(default_factory=dict)
    """By name, in the order of the params file."""
    risk: tuple[RiskRecord, ...] = ()
    """From the lowest coverage to 1."""
    break_even_steps: int | None = None
    """First step of a rollout at which the model is worse than persistence; null if it never is."""
    compared_steps: int | None = None
    """Steps in the rollouts in which it was looked for."""
    rollout_steps: int | None = None
    """Steps in the rollouts that the horizon of trust is of: those whose intervals are known from 20 validation
    episodes, or from all if there are fewer."""
    trusted_steps: int | None = None
    """For how many steps of a rollout the 90 % intervals stay within `trusted_share` of the range."""
    trusted_share: float | None = None
    step_seconds: float | None = None
    """Simulated seconds of a step."""

    @property
    def knows_break_even(self) -> bool:
        """Whether it was looked at; that it never comes is null, too."""
        return "break_even_steps" in self.model_fields_set
