"""What motion supplies to the stage that makes tables."""

from collections.abc import Callable
from pathlib import Path

from addressed_dynamics.sources.motion.conversion import convert_motion
from addressed_dynamics.sources.motion.params import MotionConvertParams


def convert(
    raw: Path,
    tables: Path,
    figures: Path,
    params: MotionConvertParams,
    *,
    cores: int,  # noqa: ARG001 - the source is one stream, read in order
    progress: Callable[[int], object],
) -> None:
    """Convert the database or the folder of clips `raw`; see `convert_motion`."""
    convert_motion(raw, tables, figures, params, progress)
