"""The section on data quality: what is wrong with the data, and what an import made of foreign logs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

from addressed_dynamics.evaluation.transitions.records import Repeats
from addressed_dynamics.reporting.common.blocks import Block, Column, Row, Table, Text
from addressed_dynamics.reporting.common.numbers import MISSING, count, percent, scientific, significant
from addressed_dynamics.reporting.transitions.recorded import DataResult, FindingResult, ImportResult, PlaceResult

FILES_SHOWN = 6
"""Imported files up to which each has a column of its own."""
WARNINGS_SHOWN = 5
"""Warnings of an import that are shown in full."""
TABLES = ("csv", "parquet")
"""Kinds of sources that may have a column of times."""
COUNTERS = {
    "messages": "messages of the topics that are used",
    "rows": "rows of the tables",
    "repeated": "of them equal to the row before, at the same time: dropped",
    "not_finite": "of them with a value that is missing or not finite: ignored",
    "backwards": "of them behind a later one in the file: put in order",
    "reordered": "of them with the names of an array in another order than before: followed by name",
    "unused": "of them between two ticks of the clock: skipped",
    "held": "ticks that used the message of the tick before once more",
    "joined_files": "files that go on from the file before: read as one recording with it",
    "incomplete_parts": "parts of a recording, between resets of the time, in which a topic is silent: left out",
    "decompressed": "messages that were compressed one by one: decompressed first",
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
        offsets = _offset_words(data.imported)
        blocks += [Text((_clock_words(data.imported), *offsets)), _import_table(data.imported)]
    return tuple(blocks)


def warning_paragraphs(imported: ImportResult) -> tuple[str, ...]:
    """Return what the import warned of, a paragraph for each of the first warnings; empty if it did not."""
    lines = [f"{origin}: {line}." for origin, each in imported.details.items() for line in each.warnings]
    if not lines:
        return ()
    number = "a warning" if len(lines) == 1 else f"{len(lines):,} warnings"
    more = len(lines) - WARNINGS_SHOWN
    rest = (f"{more:,} more are in the import's account, import.json.",) if more > 0 else ()
    return (f"The import ended with {number}.", *lines[:WARNINGS_SHOWN], *rest)


def repeated_words(found: Repeats | None) -> tuple[str, ...]:
    """Say how many test transitions stand in training too, and what errors are without them; empty if unknown."""
    if found is None or not found.rows:
        return ()
    if not found.alike:
        return (f"None of the {found.rows:,} test transitions begins as one of the {found.among:,} for training does.",)
    exact, alike = (percent(each / found.rows, 2) for each in (found.exact, found.alike))
    error = f"its error one step ahead is {significant(found.percent)} % of the range"
    without = "all of them do, so that it says nothing of others"
    if found.percent_without is not None:
        without = f"without them it is {significant(found.percent_without)} %"
    return (
        f"Of the {found.rows:,} test transitions, {exact} begin in exactly the state, with the action, of one of the "
        f"{found.among:,} for training, and {alike} do so up to the rounding of single precision. The delivered model "
        f"may know them by heart: {error}; {without}.",
    )


def _nothing_found(data: DataResult) -> str:
    # An imported clock is even whatever the logs are like: to say so would be empty praise.
    clock = "" if data.imported else "the clock ticks evenly, "
    return (
        f"Nothing was found wrong with the {data.transitions:,} transitions: {clock}no dimension is stuck, no value is "
        "out of bounds or far from all others, and no transition is there twice."
    )


def _clock_words(imported: ImportResult) -> str:
    """Say who made the clock, and whether anybody looked at the times that the logs or tables themselves have."""
    rate = "" if imported.rate_hz is None else f" ({imported.rate_hz:g} Hz)"
    made = f"The clock of the transitions was made by the import from rate_hz{rate}: it is even whatever the data are."
    if "ticks" in imported.totals:
        rates = _topic_rates(imported)
        found = f" Messages a second: {rates}." if rates else ""
        return (
            f"{made} The logs' own times were looked at: a tick at which a topic had nothing new enough was dropped, "
            f"and what was late or out of order is counted below.{found}"
        )
    if "gaps" in imported.totals:
        rates = _span([each.measured_hz for each in imported.details.values() if each.measured_hz is not None])
        found = f" Rows a second: {rates}." if rates else ""
        return (
            f"{made} The clock of the tables was looked at: a step that is not one period long begins another episode, "
            f"and is counted below.{found}"
        )
    why = "the table has no time column that the source names" if imported.kind in TABLES else "the source has none"
    return f"{made} Nobody looked at the times: {why}. Each row was taken for one step after the row before it."


def _offset_words(imported: ImportResult) -> tuple[str, ...]:
    """Say what was taken off the values; empty if nothing was."""
    if not imported.offsets:
        return ()
    taken = ", ".join(f"{offset:.12g} off {name}" for name, offset in imported.offsets.items())
    return (f"The import took {taken}; all values here and of the model are what is left.",)


def _topic_rates(imported: ImportResult) -> str:
    """Return how often each topic spoke, over all files."""
    rates: dict[str, list[float]] = {}
    for each in imported.details.values():
        for topic, details in each.topics.items():
            rates.setdefault(topic, []).extend([] if details.measured_hz is None else [details.measured_hz])
    return ", ".join(f"{_span(found)} on {topic}" for topic, found in rates.items() if found)


def _span(rates: Sequence[float]) -> str:
    ends = [f"{rate:.3g}" for rate in (min(rates), max(rates))] if rates else []
    return " to ".join(dict.fromkeys(ends))


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
    clock = "" if data.imported else "uneven time steps and gaps, "
    caption = (
        f"What may be wrong with the {data.transitions:,} transitions, how often, and where first. Each count is a "
        "share of all that were looked at: steps, episodes, values or parts of a range. Values are in the unit of "
        "their dimension, times in seconds. These were looked for, and what of them is not in the table was not "
        f"found: {clock}dimensions that are stuck, values out of bounds or far from all others, repeated transitions, "
        "and parts of a range without data."
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
