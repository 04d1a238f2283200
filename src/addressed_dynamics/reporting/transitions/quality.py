"""The section on data quality: what is wrong with the data, and what an import made of foreign logs."""

from __future__ import annotations

from pathlib import PurePath

from addressed_dynamics.reporting.common.blocks import Block, Column, Row, Table, Text
from addressed_dynamics.reporting.common.numbers import MISSING, count, percent, scientific
from addressed_dynamics.reporting.transitions.recorded import DataResult, FindingResult, ImportResult, PlaceResult

FILES_SHOWN = 6
"""Imported files up to which each has a column of its own."""
COUNTERS = {
    "messages": "messages of the topics that are used",
    "rows": "rows of the tables",
    "repeated": "of them equal to the row before, at the same time: dropped",
    "not_finite": "of them with a value that is missing or not finite: ignored",
    "backwards": "of them behind a later one in the file: put in order",
    "unused": "of them between two ticks of the clock: skipped",
    "held": "ticks that used the message of the tick before once more",
    "ticks": "ticks of the one clock",
    "gaps": "steps that are not one period long: what follows is another episode",
    "off_rate": "files whose rows come at another rate than the one that was given",
    "joined": "episodes that go on in the next file: made one",
    "unjoined": "files whose first episode may go on from the file before: kept apart, for no clock shows it",
    "missing_frames": "frames that the dataset lists and does not have",
    "unlisted_frames": "frames that the dataset has and does not list",
    "late": "ticks at which a topic had nothing new enough: dropped",
    "samples": "states with their actions",
    "out_of_range": "values beyond their bounds: kept",
    "swallowed": "steps of a dimension too small for float32: kept, as no change",
    "episodes": "episodes that were made of them",
    "short": "episodes too short: dropped",
    "dropped": "samples of the short episodes",
    "transitions": "transitions that were written",
}
"""What the counters of an import count, as far as they are known."""


def quality_blocks(data: DataResult) -> tuple[Block, ...]:
    """Return the section's tables; without findings a sentence says that there are none."""
    blocks: list[Block] = [_finding_table(data)] if data.quality else [Text((_nothing_found(data),))]
    if data.imported:
        blocks.append(_import_table(data.imported))
    return tuple(blocks)


def _nothing_found(data: DataResult) -> str:
    return (
        f"Nothing was found wrong with the {data.transitions:,} transitions: the clock ticks evenly, no dimension is "
        "stuck, no value is out of bounds or far from all others, and no transition is there twice."
    )


def _finding_table(data: DataResult) -> Table:
    columns = (
        Column("What was found", numeric=False),
        Column("dimension", numeric=False),
        Column("count"),
        Column("share"),
        Column("log", "first found in", numeric=False),
        Column("episode", "first found in"),
        Column("step", "first found in"),
        Column("value", "first found in"),
        Column("training", numeric=False),
    )
    caption = (
        f"What may be wrong with the {data.transitions:,} transitions, how often, and where first. Each count is a "
        "share of all that were looked at: steps, episodes, values or parts of a range. Values are in the unit of "
        "their dimension, times in seconds. Whatever is not in the table was looked for and not found: uneven time "
        "steps and gaps, dimensions that are stuck, values out of bounds or far from all others, repeated "
        "transitions, and parts of a range without data."
    )
    return Table(caption, columns, tuple(_finding_row(finding) for finding in data.quality))


def _finding_row(finding: FindingResult) -> Row:
    cells = (
        finding.meaning,
        finding.dimension.removeprefix("observation.") or MISSING,
        count(finding.count),
        percent(finding.count / finding.of) if finding.of else MISSING,
        *(_place(finding.first) if finding.first else (MISSING,) * 4),
        "stops" if finding.blocking else "goes on",
    )
    return Row(cells, "missed" if finding.blocking else "")


def _place(place: PlaceResult) -> tuple[str, ...]:
    numbers = (MISSING if number is None else str(number) for number in (place.episode, place.step))
    return (PurePath(place.log).name, *numbers, scientific(place.value, 3))


def _import_table(imported: ImportResult) -> Table:
    counters = list(dict.fromkeys([*imported.totals, *(name for each in imported.files.values() for name in each)]))
    shown = imported.files if 1 < len(imported.files) <= FILES_SHOWN else {}
    columns = (
        Column("Count", numeric=False),
        Column("what it is", numeric=False),
        Column("all files" if len(imported.files) > 1 else PurePath(next(iter(imported.files), "files")).name),
        *(Column(PurePath(name).name) for name in shown),
    )
    rows = [
        Row(
            (
                name.replace("_", " "),
                COUNTERS.get(name, MISSING),
                *(count(each[name]) if name in each else MISSING for each in (imported.totals, *shown.values())),
            )
        )
        for name in counters
    ]
    number = len(imported.files)
    files = "one file" if number == 1 else f"{number:,} files"
    return Table(f"What was read of {files} of logs, and what became of it.", columns, tuple(rows))
