"""From a database or a folder of clips to Parquet tables with splits, statistics and a data report.

The source is read twice: first for its clips, cycles and copies, because what is held out depends on all of them; then
to be written. Never more than a block of rows of it is in memory.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from addressed_dynamics.base.errors import MotionError
from addressed_dynamics.base.files import atomic_path, write_json
from addressed_dynamics.episodes.layout import MADE_UP
from addressed_dynamics.episodes.statistics import moments_to_json
from addressed_dynamics.sources.motion.params import MotionConvertParams
from addressed_dynamics.sources.motion.report import Figures, motion_report
from addressed_dynamics.sources.motion.source import stream_motion, survey_motion
from addressed_dynamics.sources.motion.splits import MOTION_SPLITS, TEST, TRAIN, VALIDATION, MotionSplit, plan_splits
from addressed_dynamics.sources.motion.tables import FOLDER, INPUTS, OUTPUTS, motion_writer


def convert_motion(
    source: Path, tables: Path, reports: Path, params: MotionConvertParams, progress: Callable[[int], object]
) -> None:
    """Convert the database or the folder of clips `source`; the same motion gives the same bytes.

    Args:
        source: `database.npz`, or a folder of clips.
        tables: folder for `motion/*.parquet` and `statistics.json`; replaced whole, at the end.
        reports: folder for `data.json`.
        params: what is held out, and the size of row groups.
        progress: called with the number of rows written since its last call.

    Raises:
        MotionError: the source is missing or damaged, or nothing is left to train on, to choose by or to test on.
    """
    survey = survey_motion(source)
    plan = plan_splits(survey, params)
    figures = Figures()
    with atomic_path(tables) as folder:
        with motion_writer(folder / FOLDER, row_group_rows=params.row_group_rows) as write:
            for motion in stream_motion(source, survey, rows=params.row_group_rows):
                split = plan.of(motion)
                write(motion, split)
                figures.add(motion, split)
                progress(len(motion))
        sizes = {name: int(rows) for name, rows in zip(MOTION_SPLITS, figures.split_rows, strict=True)}
        for name in (TRAIN, VALIDATION, TEST):
            _check_split(source, len(survey.groups), MOTION_SPLITS[name], sizes)
        statistics = {"splits": sizes, MOTION_SPLITS[TRAIN]: moments_to_json([*INPUTS, *OUTPUTS], figures.train)}
        write_json(folder / "statistics.json", statistics)
        write_json(reports / "data.json", motion_report(survey, figures, read_made_up(source)))


def read_made_up(source: Path) -> dict[str, Any] | None:
    """Return what the file `made_up.json` in a folder of clips says, which a program that makes up clips leaves there.

    Raises:
        MotionError: the file is damaged.
    """
    path = source / MADE_UP
    if not path.is_file():
        return None
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        message = f"{path}: should say how the clips were made up, but cannot be read ({error}); make them again"
        raise MotionError(message) from error
    return said if isinstance(said, dict) else {"program": str(said)}


def _check_split(source: Path, clips: int, split: MotionSplit, sizes: Mapping[MotionSplit, int]) -> None:
    if sizes[split]:
        return
    what = {"train": "to train on", "validation": "to choose by", "test": "to test on"}.get(split, f"for '{split}'")
    message = (
        f"{source}: its {clips} clips leave no frames {what}; give more clips, or change the shares and 'test_clips' "
        "under convert"
    )
    raise MotionError(message)
