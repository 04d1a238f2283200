"""The sections of a params file that only motion capture has."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from addressed_dynamics.params_base import Count, Section, Seed, Share


class MotionConvertParams(Section):
    """From motion to tables: what is held out, and from whom."""

    test_clips: tuple[Annotated[str, Field(min_length=1)], ...] = ()
    """Clips that are for testing, with their mirrors; empty to choose them by the hash of their names."""
    test_share: Share
    """Share of the clips kept for the evaluation, where `test_clips` is empty."""
    validation_share: Share
    """Share of the clips kept for choosing recipes; of the cycles, where there are few clips."""
    cycles_share: Share
    """Share of the cycles of other clips that are kept for the evaluation, whole."""
    rows_share: Share
    """Share of the remaining rows that are kept for an evaluation on near copies of what was trained on."""
    split_seed: Seed
    """Seed of the hash that decides what is held out."""
    row_group_rows: Count
    """Most rows in a Parquet row group."""

    @model_validator(mode="after")
    def _leaves_training_data(self) -> MotionConvertParams:
        shares = ("validation_share", "test_share"), ("cycles_share", "rows_share", "validation_share")
        for names in shares:
            if sum(getattr(self, name) for name in names) >= 1.0:
                message = f"{' + '.join(names)} must be below 1, or nothing is left to train on"
                raise ValueError(message)
        return self
