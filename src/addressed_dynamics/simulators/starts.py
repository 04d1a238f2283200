"""Where a learned environment starts: states of recorded training episodes, with the frames before them."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float32, Int32, Int64

from addressed_dynamics.base.errors import ModelError, TransitionsError
from addressed_dynamics.base.files import atomic_path, save_arrays, write_json
from addressed_dynamics.episodes.transitions import SpaceSpec
from addressed_dynamics.networks.files import read_index

FOLDER = "starts"
"""Name of the folder in a folder of models; the evaluation writes it."""
INDEX = "starts.json"
ARRAYS = "starts.npz"


@dataclass(frozen=True)
class Starts:
    """Windows of recorded episodes; the last frame of each is a state to start from."""

    spaces: SpaceSpec
    """What the numbers mean."""
    observation: Float32[np.ndarray, "start frame observation"]
    """States, oldest first, in the environment's units."""
    action: Int64[np.ndarray, "start past"] | Float32[np.ndarray, "start past action"]
    """Actions taken in all frames but the last."""
    beginning: Bool[np.ndarray, " start"]
    """Whether the window is the first of its episode."""
    episode: Int64[np.ndarray, " start"]
    """Episode that it is from."""
    step: Int32[np.ndarray, " start"]
    """Number of the last frame in that episode."""
    exogenous: Float32[np.ndarray, "row exogenous"]
    """Exogenous inputs of the recorded rows, in their own units; without rows if the spaces have none."""
    row: Int64[np.ndarray, " start"]
    """Row of `exogenous` that stands beside the first frame."""
    stop: Int64[np.ndarray, " start"]
    """Row after the last one of the episode."""
    action_range: Float32[np.ndarray, "2 action"]
    """Lowest and highest recorded component of continuous actions; without columns if they are discrete."""

    def __len__(self) -> int:
        return len(self.beginning)

    @property
    def frames(self) -> int:
        """Number of frames of a window."""
        return int(self.observation.shape[1])


COLUMNS = tuple(field.name for field in fields(Starts) if field.name != "spaces")


def write_starts(models: Path, starts: Starts | None) -> None:
    """Write starts into an experiment's folder of models, in place of what was there; None if there are none."""
    with atomic_path(models / FOLDER) as folder:
        folder.mkdir(parents=True)
        spaces = None if starts is None else starts.spaces.to_json()
        write_json(folder / INDEX, {"format": 1, "spaces": spaces})
        if starts is not None:
            save_arrays(folder / ARRAYS, {name: getattr(starts, name) for name in COLUMNS})


def read_starts(models: Path) -> Starts:
    """Read what `write_starts` wrote into a folder of models.

    Raises:
        ModelError: there are none, or a file is missing or damaged.
    """
    folder, again = models / FOLDER, f"'dvc repro evaluate@{models.name}' writes them"
    if not folder.is_dir():
        message = (
            f"{folder}: missing, so there is no recorded state to start from; evaluation keeps those of training "
            f"episodes: {again}; or give one: reset(options={{'state': ...}})"
        )
        raise ModelError(message)
    index = read_index(folder, INDEX)
    if index.get("spaces") is None:
        message = f"{folder}: it keeps no recorded state to start from: these models are of another kind of data"
        raise ModelError(message)
    try:
        with np.load(folder / ARRAYS, allow_pickle=False) as arrays:
            return Starts(SpaceSpec.from_json(index["spaces"]), **{name: arrays[name] for name in COLUMNS})
    except (OSError, KeyError, ValueError, zipfile.BadZipFile, TransitionsError) as error:
        message = f"{folder}: incomplete or damaged ({error}); {again} anew"
        raise ModelError(message) from error
