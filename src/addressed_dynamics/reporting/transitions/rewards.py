"""The report's block on reward and end of a learned environment: who says them, and how well."""

from __future__ import annotations

from collections.abc import Iterator

from addressed_dynamics.evaluation.transitions.reward_records import JudgedTask, TaskRecord
from addressed_dynamics.reporting.common.blocks import Block, Column, Row, Table, Text
from addressed_dynamics.reporting.common.numbers import MISSING, listed, scientific, significant
from addressed_dynamics.simulators.rewards import LEARNED, NOBODY

FEW_ENDS = 20
"""Recorded ends below which what is learned of them is not to be relied on."""


def reward_blocks(record: TaskRecord | None) -> tuple[Block, ...]:
    """Return who says reward and end of an environment of the model; nothing if that was not judged."""
    if record is None:
        return ()
    table = (_table(record),) if record.judged else ()
    return (Text((" ".join(_sentences(record)),)), *table)


def _sentences(record: TaskRecord) -> Iterator[str]:
    reward, end = record.reward_source, record.end_source
    if reward == end == NOBODY:
        yield "In an environment of this model the reward is 0 and no episode ends: the logs have neither."
    elif reward == end:
        yield f"In an environment of this model {_who(reward)} reward and end of a step."
    elif reward == NOBODY:
        yield "In an environment of this model the reward is 0, for the logs have none; ends are learned from them."
    else:
        yield (
            f"In an environment of this model {_who(reward)} the reward; no episode ends, for none that was recorded "
            "terminated."
        )
    if LEARNED in record.judged and record.ends_in_training:
        few = f": fewer than {FEW_ENDS}, which is little to learn from" if record.ends_in_training < FEW_ENDS else ""
        yield f"{record.ends_in_training:,} training episodes terminated{few}."
    if record.silent_steps:
        total = sum(record.silent_steps.values())
        segments = listed([f"“{name}”" for name in record.silent_steps])
        yield (
            f"{total:,} training steps of {segments}, where no episode terminates while others do, were left out in "
            "learning and judging ends."
        )


def _who(source: str) -> str:
    return "networks that learned it from the logs say" if source == LEARNED else f"the known function {source} says"


def _table(record: TaskRecord) -> Table:
    columns = (
        Column("Who says it", numeric=False),
        Column("RMSE", "reward"),
        Column("largest error", "reward"),
        Column("false ends", "per thousand"),
        Column("missed ends", "per thousand"),
        Column("ends"),
    )
    used = {record.reward_source, record.end_source}
    rows = tuple(Row(_cells(name, each), "own" if name in used else "") for name, each in record.judged.items())
    caption = (
        "Reward and end on test episodes, from their true states. False ends: of a thousand steps that go on, those "
        "that are said to end the episode; missed ends: of a thousand that end it, those that are said to go on. A "
        f"time limit is no end. The rewards there deviate by {significant(record.reward_deviation)} from their mean."
    )
    return Table(caption, columns, rows)


def _cells(name: str, judged: JudgedTask) -> tuple[str, ...]:
    return (
        "learned from the logs" if name == LEARNED else name.partition(":")[2],
        scientific(judged.reward_rmse),
        scientific(judged.reward_largest_error),
        MISSING if judged.false_ends_per_thousand is None else significant(judged.false_ends_per_thousand, 2),
        MISSING if judged.missed_ends_per_thousand is None else significant(judged.missed_ends_per_thousand, 2),
        f"{judged.ends:,}",
    )
