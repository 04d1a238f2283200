"""The data of an experiment of motion: what data.json says, and the section of the report that it makes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import Field

from addressed_dynamics.episodes.layout import FRAME_RATE
from addressed_dynamics.evaluation.common.records import Record
from addressed_dynamics.reporting.common.blocks import Block, Column, Row, Table, Text
from addressed_dynamics.reporting.common.numbers import MISSING, count, listed, percent, significant

MOST_CLIPS = 40
"""Clips up to which each has a line of its own."""
SPLITS = {
    "train": "training",
    "validation": "validation",
    "test": "held-out clips",
    "cycles": "held-out cycles",
    "rows": "held-out frames",
}
"""What a reader should see for each split."""


class Source(Record):
    """What was found in the files."""

    rows: int
    exact_duplicates: int
    other_patches: int
    boundaries: str
    """How clips are told apart: `files`, `meta` or `phase`."""
    made_up: dict[str, Any] | None = None
    """By which program the clips were made up, and from what; None for motion capture."""


class SplitSize(Record):
    """Size of a split."""

    rows: int
    clips: int


class ClipResult(Record):
    """One recording."""

    group: str
    """Itself and its mirror."""
    rows: int
    cycles: int
    seconds: float
    splits: dict[str, int]


class Speeds(Record):
    """Quantiles of the speed of the root."""

    q05: float
    q50: float
    q95: float


class Jump(Record):
    """Largest difference between an output and the input of the next frame."""

    value: float
    unit: str


class Quality(Record):
    """What may be wrong with the data."""

    constant_columns: tuple[str, ...]
    flat_terrain: bool
    greatest_jump_inside_cycles: dict[str, Jump]


class MotionData(Record):
    """data.json."""

    rows: int
    seconds: float
    source: Source
    splits: dict[str, SplitSize]
    clips: dict[str, ClipResult] = Field(min_length=1)
    gaits: dict[str, float]
    speed: dict[str, Speeds | str]
    """By gait, and over all; and their `unit`."""
    quality: Quality

    @property
    def made_up(self) -> bool:
        """Whether a program made up the clips."""
        return self.source.made_up is not None

    @property
    def groups(self) -> dict[str, list[ClipResult]]:
        """Clips with their mirrors."""
        found: dict[str, list[ClipResult]] = {}
        for clip in self.clips.values():
            found.setdefault(clip.group, []).append(clip)
        return found


def data_blocks(data: MotionData) -> tuple[Block, ...]:
    """Return the section on the data."""
    return (Text(summary(data)), _clip_table(data), _gait_table(data), Text((_quality(data.quality),)))


def minutes(seconds: float) -> str:
    """Return a length of time in words."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.1f} min"


def summary(data: MotionData) -> tuple[str, ...]:
    """Return how much there is, and how it is split."""
    sizes = listed([f"{split.rows:,} for {SPLITS.get(name, name)}" for name, split in data.splits.items()])
    number, groups = len(data.clips), len(data.groups)
    mirrors = f", {groups} recordings with their mirrors" if groups < number else ""
    text = (
        f"{data.rows:,} frames at {FRAME_RATE} Hz ({minutes(data.seconds)}) of {number:,} clips{mirrors}. Frames: "
        f"{sizes}. Held-out clips are kept whole together with their mirrors and share nothing with training; held-out "
        "cycles are whole gait cycles of clips that are trained on; held-out frames are single frames between two "
        "that are trained on, 1/60 s before and after them, as the paper's test set was drawn."
    )
    if data.made_up:
        made_up = (
            "All of these clips are synthetic: a program makes up a walker who follows a script, in the file format of "
            "the published motion capture. They show whether everything works and how the models compare on one and "
            "the same data; they do not show how well any of the models moves like a person."
        )
        return (made_up, text)
    return (text,)


def _clip_table(data: MotionData) -> Table:
    splits = [name for name, split in data.splits.items() if split.rows]
    columns = (
        Column("Clip", numeric=False),
        Column("files"),
        Column("cycles"),
        Column("seconds"),
        *(Column(SPLITS.get(name, name), "frames") for name in splits),
    )
    groups = sorted(data.groups.items())
    rows = [_clip_row(name, clips, splits) for name, clips in groups[:MOST_CLIPS]]
    if len(groups) > MOST_CLIPS:
        rest = [clip for _, clips in groups[MOST_CLIPS:] for clip in clips]
        rows.append(_clip_row(f"{len(groups) - MOST_CLIPS} more", rest, splits))
    rows.append(_clip_row("all", list(data.clips.values()), splits, "own"))
    told = {"files": "by their files", "meta": "as the database says", "phase": "by their phase"}
    source = data.source
    copies = (
        f"Of {source.rows:,} rows {source.exact_duplicates:,} were exact copies and {source.other_patches:,} the same "
        "motion on other terrain; they were left out."
        if source.exact_duplicates or source.other_patches
        else f"None of the {source.rows:,} rows is a copy of another, or the same motion on other terrain."
    )
    caption = (
        "Clips, each together with its mirror, and what their frames are for. Clips were told apart "
        f"{told.get(source.boundaries, source.boundaries)}. {copies}"
    )
    return Table(caption, columns, tuple(rows))


def _clip_row(name: str, clips: list[ClipResult], splits: list[str], kind: str = "") -> Row:
    frames = [sum(clip.splits.get(split, 0) for clip in clips) for split in splits]
    cells = (
        count(len(clips)),
        count(sum(clip.cycles for clip in clips)),
        f"{sum(clip.seconds for clip in clips):,.1f}",
    )
    return Row((name.replace("_", " "), *cells, *(count(each) if each else MISSING for each in frames)), kind)


def _gait_table(data: MotionData) -> Table:
    columns = (
        Column("Gait", numeric=False),
        Column("share of frames"),
        *(Column(title, "speed over the ground, cm/s") for title in ("5 %", "median", "95 %")),
    )
    known: Mapping[str, Speeds] = {name: each for name, each in data.speed.items() if isinstance(each, Speeds)}
    rows = [
        Row((gait, percent(share), *_speed_cells(known.get(gait)))) for gait, share in data.gaits.items() if share > 0
    ]
    rows.append(Row(("all", percent(1.0), *_speed_cells(known.get("all"))), "own"))
    absent = [gait for gait, share in data.gaits.items() if not share]
    without = f" There is no {' and no '.join(absent)} in these clips." if absent else ""
    return Table(
        f"How the frames move: mean share of each gait, and how fast the root goes.{without}", columns, tuple(rows)
    )


def _speed_cells(speeds: Speeds | None) -> tuple[str, ...]:
    return (
        (MISSING,) * 3 if speeds is None else tuple(significant(each) for each in (speeds.q05, speeds.q50, speeds.q95))
    )


def _quality(quality: Quality) -> str:
    blocks: dict[str, int] = {}
    for name in quality.constant_columns:
        block = ".".join(name.split(".")[:2])
        blocks[block] = blocks.get(block, 0) + 1
    constant = (
        f"{len(quality.constant_columns)} columns never change, in {len(blocks)} blocks: terrain on flat ground, gaits "
        "that do not occur, and what is zero in the frame of the root by definition are among them."
        if blocks
        else "No column is constant."
    )
    ground = "The ground is flat everywhere." if quality.flat_terrain else "The ground is not flat."
    jumps = {name: jump for name, jump in quality.greatest_jump_inside_cycles.items() if jump.value > 0}
    # Only the height of joints above the ground may differ, where the ground rises.
    worst = "; ".join(
        f"{name.replace('_', ' ')} {significant(jump.value)}{f' {jump.unit}' * bool(jump.unit)}"
        for name, jump in jumps.items()
    )
    steady = (
        f"Inside a cycle the outputs of a frame differ from the inputs of the next by at most: {worst}."
        if jumps
        else "Inside a cycle the outputs of every frame are exactly the inputs of the next."
    )
    return f"Quality: {constant} {ground} {steady}"
