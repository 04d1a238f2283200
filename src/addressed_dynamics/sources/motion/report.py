"""A short report on motion: how much of which clips, what is held out, how it moves, and what is odd about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int8, Int64

from addressed_dynamics.episodes.layout import AXES, FRAME_RATE, GAITS, INPUT, INPUT_HEIGHTS, NOW, OUTPUT, Layout
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.episodes.statistics import Moments, Sample
from addressed_dynamics.sources.motion.contents import CycleRows, Survey
from addressed_dynamics.sources.motion.splits import MOTION_SPLITS, TRAIN
from addressed_dynamics.sources.motion.tables import INPUTS, OUTPUTS

CHUNK = 2**11
"""Rows that are summarised at once, in float64."""


def _axis(layout: Layout, axis: str) -> slice:
    """Return the columns of the positions of all joints along an axis."""
    joints = layout.joint_position
    return slice(joints.start + AXES.index(axis), joints.stop, len(AXES))


TRAJECTORY = ("trajectory_position_x", "trajectory_position_z", "trajectory_direction_x", "trajectory_direction_z")
SAME_QUANTITIES: dict[str, tuple[slice, slice]] = {
    **{f"joint_position_{axis}": (_axis(OUTPUT, axis), _axis(INPUT, axis)) for axis in AXES},
    "joint_velocity": (OUTPUT.joint_velocity, INPUT.joint_velocity),
    **{name: (OUTPUT[name], slice(INPUT[name].start + NOW, INPUT[name].stop)) for name in TRAJECTORY},
}
"""Columns of an output, and those of the input of the next frame that mean the same."""
ROUNDING = 1e-6
"""A column that varies by no more is constant: heights of flat terrain vary by 1e-15 cm."""
SPEEDS = (0.05, 0.5, 0.95)
"""The report names the speeds that these shares of the rows do not exceed: `q05`, `q50`, `q95`."""


class Figures:
    """Figures on the rows that are kept, gathered block by block."""

    def __init__(self) -> None:
        nothing = Moments.of(np.empty((0, INPUT.width + OUTPUT.width)))
        self.train = nothing
        """Mean and spread of inputs and outputs in training."""
        self.all = nothing
        """The same of all rows."""
        self.split_rows = np.zeros(len(MOTION_SPLITS), dtype=np.int64)
        """Number of rows in each split."""
        self.clips: dict[str, Int64[np.ndarray, " split"]] = {}
        """Number of rows of each clip in each split."""
        self.gaits = Moments.of(np.empty((0, len(GAITS))))
        """Share of each gait at the frame itself."""
        self.speeds: dict[str, list[Sample]] = {}
        """Speed of the root in cm/s in each block, by the gait that has the greatest share."""
        self.jumps: dict[str, float] = {}
        """Greatest difference between an output and the same quantity in the input of the next frame."""

    def add(self, motion: Motion, split: Int8[np.ndarray, " row"]) -> None:
        """Add rows, of whole cycles."""
        for start in range(0, len(motion), CHUNK):
            rows = slice(start, start + CHUNK)
            values = np.concatenate([motion.x[rows], motion.y[rows]], axis=1)
            moments = Moments.of(values[split[rows] == TRAIN])
            self.train = self.train.merge(moments)
            self.all = self.all.merge(moments).merge(Moments.of(values[split[rows] != TRAIN]))
        self.split_rows += np.bincount(split, minlength=len(MOTION_SPLITS))
        for clip in np.unique(motion.clip).tolist():
            counts = np.bincount(split[motion.clip == clip], minlength=len(MOTION_SPLITS))
            self.clips[clip] = self.clips.get(clip, 0) + counts
        self._add_gaits(motion)
        self._add_jumps(motion)

    def _add_gaits(self, motion: Motion) -> None:
        gaits = np.stack([motion.x[:, INPUT[f"gait_{gait}"]][:, NOW] for gait in GAITS], axis=1)
        self.gaits = self.gaits.merge(Moments.of(gaits))
        speed = np.linalg.norm(motion.y[:, OUTPUT.root_velocity].astype(np.float64), axis=1) * FRAME_RATE
        named = {"all": np.ones(len(motion), dtype=bool)}
        named |= {gait: gaits.argmax(axis=1) == index for index, gait in enumerate(GAITS)}
        for name, rows in named.items():
            if rows.any():
                self.speeds.setdefault(name, []).append(Sample.of(speed[rows, None]))

    def _add_jumps(self, motion: Motion) -> None:
        """Compare the outputs of each row with the inputs of the next one of the same cycle."""
        same = (motion.clip[1:] == motion.clip[:-1]) & (motion.cycle[1:] == motion.cycle[:-1])
        follows = (same & (np.diff(motion.frame) == 1))[:, None]
        for name, (answers, inputs) in SAME_QUANTITIES.items():
            difference = np.abs(motion.y[:-1, answers] - motion.x[1:, inputs])
            greatest = float(difference.max(initial=0.0, where=follows))
            self.jumps[name] = max(self.jumps.get(name, 0.0), greatest)


def motion_report(survey: Survey, figures: Figures, made_up: Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the report as JSON-compatible values.

    Args:
        survey: what the source holds.
        figures: what was counted of its rows; of one at least.
        made_up: by which program the clips were made up, and from what; None for motion capture.
    """
    return {
        "rows": survey.kept_rows,
        "seconds": _seconds(survey.cycles),
        "source": {
            "kind": "pfnn_clips" if survey.boundaries == "files" else "pfnn_database",
            "rows": survey.rows,
            "exact_duplicates": survey.exact_duplicates,
            "other_patches": survey.other_patches,
            "boundaries": survey.boundaries,
            "made_up": made_up,
        },
        "splits": {
            name: {"rows": int(rows), "clips": sum(int(counts[index] > 0) for counts in figures.clips.values())}
            for index, (name, rows) in enumerate(zip(MOTION_SPLITS, figures.split_rows, strict=True))
        },
        "clips": _clips(survey, figures),
        "gaits": dict(zip(GAITS, map(float, figures.gaits.mean), strict=True)),
        "speed": {"unit": "cm/s", **{name: _speeds(figures.speeds[name]) for name in figures.speeds}},
        "quality": _quality(figures),
    }


def _clips(survey: Survey, figures: Figures) -> dict[str, Any]:
    cycles: dict[str, list[CycleRows]] = {}
    for cycle in survey.cycles:
        cycles.setdefault(cycle.clip, []).append(cycle)
    return {
        clip: {
            "group": survey.groups[clip],
            "rows": sum(cycle.rows for cycle in members),
            "cycles": len(members),
            "seconds": _seconds(members),
            "splits": {
                name: int(count) for name, count in zip(MOTION_SPLITS, figures.clips[clip], strict=True) if count
            },
        }
        for clip, members in cycles.items()
    }


def _quality(figures: Figures) -> dict[str, Any]:
    constant = figures.all.maximum - figures.all.minimum <= ROUNDING
    names = np.array([*INPUTS, *OUTPUTS])
    return {
        "constant_columns": names[constant].tolist(),
        "flat_terrain": bool((constant & (abs(figures.all.maximum) <= ROUNDING))[INPUT_HEIGHTS].all()),
        # Outputs are the inputs of the next frame. Only `joint_position_y` may differ, on hills.
        "greatest_jump_inside_cycles": {
            name: {"value": value, "unit": _unit(name)} for name, value in figures.jumps.items()
        },
    }


def _unit(quantity: str) -> str:
    return next(block.unit for block in OUTPUT.blocks if quantity.startswith(block.name))


def _seconds(cycles: Sequence[CycleRows]) -> float:
    """Return how long cycles take, from their first to their last frames."""
    return sum(cycle.rows - 1 for cycle in cycles) / FRAME_RATE


def _speeds(parts: Sequence[Sample]) -> dict[str, float]:
    values = Sample.join(parts).quantiles(*SPEEDS)[:, 0]
    return {f"q{round(share * 100):02d}": float(value) for share, value in zip(SPEEDS, values, strict=True)}
