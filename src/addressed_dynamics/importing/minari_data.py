"""Samples from a Minari dataset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.columns import column_values, keep_usable
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.samples import Samples
from addressed_dynamics.importing.signals import Signals


def read_minari(dataset: str, signals: Signals, agreement: Agreement) -> Samples:
    """Read all episodes of a dataset.

    Its columns are `observations`, `actions` and `rewards`; the parts of an observation that is a dictionary are
    `observations.part`. Vectors are taken apart by a place or a slice: `observations[0:4]`.

    Args:
        dataset: identifier of a dataset on this machine, or its folder.
        signals: what to read.
        agreement: what all episodes have to agree in.

    Raises:
        TableError: Minari is not installed, there is no such dataset, it is damaged, or it lacks a column.
        LogError: the episodes do not agree in the length of their vectors.
    """
    values, breaks, terminated = [], [], []
    for number, episode in enumerate(_episodes(dataset)):
        where = f"{dataset}, episode {number}"
        columns = _columns(episode)
        length = len(next(iter(columns.values())))
        values.append(column_values(where, _frame(where, columns), signals.all, agreement))
        breaks.append(np.arange(length) == 0)
        terminated.append(np.append(False, np.asarray(episode.terminations, dtype=np.bool_)))
    if not values:
        message = f"{dataset}: expected episodes, but the dataset has none"
        raise TableError(message)
    return keep_usable(np.concatenate(values), np.concatenate(breaks), np.concatenate(terminated))


def _episodes(dataset: str) -> Iterator[Any]:
    try:
        import minari
    except ImportError as error:
        message = f"{dataset}: Minari is not installed; install it with: pip install 'addressed-dynamics[minari]'"
        raise TableError(message) from error
    try:
        folder = Path(dataset)
        if folder.is_dir():
            yield from minari.MinariDataset(folder / "data").iterate_episodes()
        else:
            yield from minari.load_dataset(dataset).iterate_episodes()
    except TableError:
        raise
    except Exception as error:  # Minari raises whatever its storage does
        message = f"{dataset}: the dataset cannot be read ({reason(error)}); give its folder, or download it again"
        raise TableError(message) from error


def _columns(episode: Any) -> dict[str, np.ndarray]:
    """Return the arrays of an episode; an episode has one observation more than actions, whose place stays empty."""
    observations = episode.observations
    parts = {"observations": observations}
    if isinstance(observations, dict):
        parts = {f"observations.{name}": part for name, part in observations.items()}
    columns = {name: np.asarray(part) for name, part in parts.items()}
    for name in ("actions", "rewards"):
        array = np.asarray(getattr(episode, name))
        # The last sample's action and reward are never used, but they have to be something.
        columns[name] = np.concatenate([array, array[-1:]])
    return columns


def _frame(where: str, columns: dict[str, np.ndarray]) -> polars.DataFrame:
    try:
        return polars.DataFrame(
            {name: array if array.ndim == 1 else array.reshape(len(array), -1) for name, array in columns.items()}
        )
    except Exception as error:  # arrays of different lengths, objects, tuples
        message = f"{where}: its arrays do not make a table ({reason(error)}); only vectors and numbers can be read"
        raise TableError(message) from error
