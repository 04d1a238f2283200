"""Samples from a Minari dataset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.columns import Table, column_values
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.samples import Samples, keep_usable
from addressed_dynamics.importing.signals import Signals


def read_minari(dataset: str, signals: Signals, agreement: Agreement) -> Samples:
    """Read all episodes of a dataset.

    Its columns are `observations`, `actions` and `rewards`. The parts of what is a dictionary are `observations.part`,
    those of what is a tuple `observations[0]`, however deep. Vectors are taken apart by a place or a slice:
    `observations[0:4]`. Parts that nobody asks for do not matter.

    Args:
        dataset: identifier of a dataset on this machine, or its folder.
        signals: what to read.
        agreement: what all episodes have to agree in.

    Raises:
        TableError: Minari is not installed, there is no such dataset, it is damaged, or it lacks a column.
        LogError: the episodes do not agree in the length of their vectors.
    """
    values, breaks, terminated = [], [], []
    for number, episode in enumerate(minari_episodes(dataset)):
        table = minari_table(f"{dataset}, episode {number}", episode)
        values.append(column_values(table, signals.all, agreement))
        breaks.append(np.arange(table.length) == 0)
        terminated.append(np.append(False, np.asarray(episode.terminations, dtype=np.bool_)))
    if not values:
        message = f"{dataset}: expected episodes, but the dataset has none"
        raise TableError(message)
    return keep_usable(np.concatenate(values), np.concatenate(breaks), terminated=np.concatenate(terminated))


def minari_table(where: str, episode: Any) -> Table:
    """Return an episode as a table with a row for each observation."""
    parts, length = _columns(episode), len(episode.terminations) + 1
    return Table(
        where=where,
        names=tuple(parts),
        length=length,
        column=lambda name, _: _series(where, name, parts[name], length),
        row=lambda row: f"step {row}",
    )


def minari_episodes(dataset: str) -> Iterator[Any]:
    """Yield the episodes of a dataset.

    Raises:
        TableError: Minari is not installed, or there is no such dataset, or it is damaged.
    """
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


def _columns(episode: Any) -> dict[str, Any]:
    """Return the arrays of an episode by their names; an episode has one observation more than actions.

    The last place of actions and rewards is not used, but there has to be something, so it holds the one before.
    """
    return {
        **dict(_parts("observations", episode.observations)),
        **{name: _and_last(part) for name, part in _parts("actions", episode.actions)},
        "rewards": _and_last(episode.rewards),
    }


def _parts(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Yield the arrays in nested dictionaries and tuples as `name.key` and `name[place]`."""
    match value:
        case dict():
            for key, part in value.items():
                yield from _parts(f"{name}.{key}", part)
        case tuple():
            for place, part in enumerate(value):
                yield from _parts(f"{name}[{place}]", part)
        case _:
            yield name, value


def _and_last(array: Any) -> Any:
    return [*array, *array[-1:]] if isinstance(array, list) else np.concatenate([array, array[-1:]])


def _series(where: str, name: str, part: Any, length: int) -> polars.Series:
    try:
        array = np.asarray(part)
        series = polars.Series(name, array if array.ndim == 1 else array.reshape(len(array), -1))
    except Exception as error:  # objects, vectors of different lengths
        message = f"{where}: '{name}' is no column ({reason(error)}); only vectors and numbers can be read"
        raise TableError(message) from error
    if len(series) != length:
        message = f"{where}: '{name}' has {len(series)} values, but {length} were expected; download the dataset again"
        raise TableError(message)
    return series
