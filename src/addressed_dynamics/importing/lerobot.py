"""Samples from a LeRobot dataset: Parquet files of frames, and an account of them in JSON.

Layout: https://github.com/huggingface/lerobot. Version 3 has many episodes in a file `data/chunk-*/file-*.parquet` and
lists them in `meta/episodes/*/*.parquet`; version 2 has a file `data/chunk-*/episode_*.parquet` for each and lists them
in `meta/episodes.jsonl`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import polars

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.params.source import LerobotSource
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.columns import longest_beginning
from addressed_dynamics.importing.decoding import reason
from addressed_dynamics.importing.rows import Clock, Rows
from addressed_dynamics.importing.samples import Samples
from addressed_dynamics.importing.seams import FileRows, join_seams
from addressed_dynamics.importing.signals import LEROBOT_EPISODE, Signal, Signals
from addressed_dynamics.importing.tables import finished, natural_order, open_parquet, rows_of

FRAME, TIME = "frame_index", "timestamp"
"""Columns with the number of a frame in its episode, and its time in seconds."""

_VERSION = re.compile(r"v?[23]\.\d+")
_NAMED = re.compile(r"\[([^\[\]]*[^\[\]0-9:][^\[\]]*)\]$")


@dataclass(frozen=True)
class Dataset:
    """What a dataset says of itself in `meta/info.json`."""

    folder: Path
    fps: float
    """Frames in a second."""
    names: dict[str, tuple[str, ...]]
    """Names of the elements of each vector that has any."""
    videos: tuple[str, ...]
    """Features that are not in the tables."""


def read_info(source: LerobotSource) -> Dataset:
    """Read what a dataset says of itself.

    Raises:
        TableError: there is no such file, it is damaged or of another version, or its rate is not the one that the
            source names.
    """
    path = Path(source.folder) / "meta" / "info.json"
    info = _json(path, _text(path))
    version, fps = info.get("codebase_version"), info.get("fps")
    if not isinstance(version, str) or not _VERSION.fullmatch(version):
        message = f"{path}: codebase_version is {version!r:.40}, but versions 2 and 3 can be read; convert the dataset"
        raise TableError(message)
    if isinstance(fps, bool) or not isinstance(fps, int | float) or not 0 < fps < math.inf:
        message = f"{path}: fps should be the number of frames in a second, but is {fps!r:.40}; correct it"
        raise TableError(message)
    if source.rate_hz is not None and not math.isclose(source.rate_hz, fps, rel_tol=1e-6):
        message = f"{path}: the dataset has {fps:g} frames in a second, but rate_hz is {source.rate_hz:g}; leave it out"
        raise TableError(message)
    features = info.get("features")
    features = features if isinstance(features, dict) else {}
    described = {name: each for name, each in features.items() if isinstance(each, dict)}
    return Dataset(
        folder=Path(source.folder),
        fps=float(fps),
        names={name: names for name, each in described.items() if (names := _element_names(each))},
        videos=tuple(name for name, each in described.items() if each.get("dtype") == "video"),
    )


def read_lerobot(dataset: Dataset, signals: Signals, agreement: Agreement) -> Iterator[tuple[str, Samples]]:
    """Yield the samples of each file of a dataset of version 3, or of each chunk of one of version 2.

    `episode_index` separates episodes; a step of `frame_index` that is not one, or of `timestamp` that is not one
    period, begins another one.

    Raises:
        TableError: a file is missing or damaged, lacks a column or a name, or time does not go on in an episode.
        LogError: the files do not agree in the length of their vectors.
    """
    clocks = (Clock(FRAME, 0.0, 1.0, None), Clock(TIME, 0.5, 1.0 / dataset.fps, 1.0))
    resolved = _resolved(dataset, signals)
    fields = [*(signal.field for signal in resolved.all), FRAME, TIME]
    lengths, found = _episode_lengths(dataset), dict[int, int]()

    def read() -> Iterator[FileRows]:
        for origin, files in _origins(dataset):
            parts = []
            for file in files:
                table = open_parquet(file, fields)
                if LEROBOT_EPISODE in table.names:
                    _count_frames(table.column(LEROBOT_EPISODE, signals.all[0]), found)
                parts.append(rows_of(table, resolved, clocks, agreement))
            yield FileRows(origin.as_posix(), reduce(Rows.followed_by, parts))

    last: tuple[str, Samples] | None = None
    for file in join_seams(read(), resolved, clocks):
        if last is not None:
            yield last
        last = (file.origin, finished(file, resolved, clocks))
    if last is not None:
        yield last[0], _with_account(last[1], lengths, found)


def lerobot_files(dataset: Dataset) -> list[Path]:
    """Return the files of a dataset.

    Raises:
        TableError: there are none.
    """
    return [file for _, files in _origins(dataset) for file in files]


def _origins(dataset: Dataset) -> list[tuple[Path, list[Path]]]:
    """Return the files that belong together, with what they are called together."""
    files = sorted((dataset.folder / "data").glob("chunk-*/*.parquet"), key=natural_order)
    if not files:
        message = f"{dataset.folder}: there is no data/chunk-*/*.parquet; name the folder with 'data' and 'meta' in it"
        raise TableError(message)
    origins: dict[Path, list[Path]] = {}
    for file in files:
        # A file for each episode would make a log for each.
        origins.setdefault(file.parent if file.name.startswith("episode_") else file, []).append(file)
    return list(origins.items())


def _resolved(dataset: Dataset, signals: Signals) -> Signals:
    def resolve(signal: Signal) -> Signal:
        return replace(signal, field=_place(dataset, signal.field))

    def resolve_one(signal: Signal | None) -> Signal | None:
        return None if signal is None else resolve(signal)

    return replace(
        signals,
        observation=tuple(resolve(signal) for signal in signals.observation),
        action=tuple(resolve(signal) for signal in signals.action),
        exogenous=tuple(resolve(signal) for signal in signals.exogenous),
        reward=resolve_one(signals.reward),
        terminated=resolve_one(signals.terminated),
        truncated=resolve_one(signals.truncated),
    )


def _place(dataset: Dataset, field: str) -> str:
    """Put the place of an element in the place of its name: `action[gripper.pos]` is `action[5]`."""
    where = dataset.folder / "meta" / "info.json"
    video = longest_beginning(field, dataset.videos)
    if video is not None:
        message = f"{where}: '{video}' is a video, but numbers are wanted; name another feature"
        raise TableError(message)
    named = _NAMED.search(field)
    if named is None:
        return field
    feature, name = field[: named.start()], named[1]
    names = dataset.names.get(feature, ())
    if names.count(name) != 1:
        listed = ", ".join(names) or "none; write its place, from 0"
        what = "several elements" if name in names else "no element"
        message = f"{where}: '{feature}' has {what} of the name '{name}'; the names are: {listed}"
        raise TableError(message)
    return f"{feature}[{names.index(name)}]"


def _element_names(feature: dict[str, Any]) -> tuple[str, ...]:
    names, shape = feature.get("names"), feature.get("shape")
    if isinstance(names, dict) and len(names) == 1:  # such as {motors: [...]}
        (names,) = names.values()
    # Where the number differs, the names are those of axes.
    if not isinstance(names, list) or shape != [len(names)] or not all(isinstance(name, str) for name in names):
        return ()
    return tuple(names)


def _episode_lengths(dataset: Dataset) -> dict[int, int]:
    """Return the number of frames that the dataset's own list gives each episode; empty without a list."""
    meta = dataset.folder / "meta"
    files = sorted((meta / "episodes").glob("*/*.parquet"), key=natural_order)
    lines = meta / "episodes.jsonl"
    lengths: dict[int, int] = {}
    for file in files:
        try:
            frame = polars.read_parquet(file, columns=[LEROBOT_EPISODE, "length"])
        except (Exception, polars.exceptions.PanicException) as error:
            message = f"{file}: the list of episodes cannot be read ({reason(error)}); download the dataset again"
            raise TableError(message) from error
        lengths |= _as_lengths(file, frame.to_dicts())
    if not files and lines.exists():
        lengths |= _as_lengths(lines, [_json(lines, line) for line in _text(lines).splitlines() if line.strip()])
    return lengths


def _as_lengths(path: Path, entries: Sequence[dict[str, Any]]) -> dict[int, int]:
    try:
        return {int(entry[LEROBOT_EPISODE]): int(entry["length"]) for entry in entries}
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        message = f"{path}: an entry has no number under '{LEROBOT_EPISODE}' or 'length'; download the dataset again"
        raise TableError(message) from error


def _count_frames(column: polars.Series, found: dict[int, int]) -> None:
    if column.dtype.is_integer():
        for episode, count in zip(*np.unique(column.drop_nulls().to_numpy(), return_counts=True), strict=True):
            found[int(episode)] = found.get(int(episode), 0) + int(count)


def _with_account(samples: Samples, lengths: dict[int, int], found: dict[int, int]) -> Samples:
    """Count the frames that the list of episodes has and the data lack, and the other way round; zeros left out."""
    episodes = lengths.keys() | found.keys() if lengths else ()
    more = {each: found.get(each, 0) - lengths.get(each, 0) for each in sorted(episodes)}
    counts = {
        "missing_frames": -sum(count for count in more.values() if count < 0),
        "unlisted_frames": sum(count for count in more.values() if count > 0),
    }
    differing = {str(each): count for each, count in more.items() if count}
    if not differing:
        return samples
    return replace(
        samples,
        counts=samples.counts | {name: count for name, count in counts.items() if count},
        details=samples.details | {"frames_beside_the_list": differing},
    )


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the file cannot be read ({reason(error)}); name the folder of a LeRobot dataset"
        raise TableError(message) from error


def _json(path: Path, text: str) -> dict[str, Any]:
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        message = f"{path}: the file is no JSON ({reason(error)}); download the dataset again"
        raise TableError(message) from error
    if not isinstance(value, dict):
        message = f"{path}: expected keys with values, found {type(value).__name__}; download the dataset again"
        raise TableError(message)
    return value
