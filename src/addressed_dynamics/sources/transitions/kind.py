"""What transitions supply to the stage that makes tables."""

from collections.abc import Callable
from pathlib import Path

from addressed_dynamics.sources.transitions.conversion import convert_recording
from addressed_dynamics.sources.transitions.params import ConvertParams


def convert(
    raw: Path, tables: Path, figures: Path, params: ConvertParams, *, cores: int, progress: Callable[[int], object]
) -> None:
    """Convert the logs in the folder `raw`; see `convert_recording`."""
    convert_recording(raw, tables, figures, params, cores=cores, progress=progress)
