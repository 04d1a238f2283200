"""From a text file of temperatures to tables."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
from addressed_dynamics.sources.thermostat.params import ConvertParams

from addressed_dynamics.base.files import atomic_path, save_arrays, write_json


def convert(
    raw: Path, tables: Path, figures: Path, params: ConvertParams, *, cores: int, progress: Callable[[int], object]
) -> None:
    """Read one temperature a line."""
    del cores
    values = np.loadtxt(raw / "room.txt", dtype=np.float32)
    end = round(len(values) * (1 - params.test_share))
    with atomic_path(tables) as folder:
        folder.mkdir()
        save_arrays(folder / "values.npz", {"train": values[:end], "test": values[end:]})
    write_json(figures / "data.json", {"rows": len(values)})
    progress(len(values))
