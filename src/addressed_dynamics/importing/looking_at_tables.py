"""What tables hold that nobody has described: their columns with ranges, and which of them says the time."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import polars

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.base.params.source import CsvSource, LerobotSource
from addressed_dynamics.importing.clock import usual_period
from addressed_dynamics.importing.columns import Table
from addressed_dynamics.importing.csv_text import open_csv
from addressed_dynamics.importing.finding import Found
from addressed_dynamics.importing.lerobot import FRAME, TIME, lerobot_files, read_info
from addressed_dynamics.importing.looking import LONGEST_ARRAY, MOST_TEXTS, MOST_VALUES, Field, Look, unit_in
from addressed_dynamics.importing.minari_data import minari_episodes, minari_table
from addressed_dynamics.importing.signals import LEROBOT_EPISODE, plain_signal
from addressed_dynamics.importing.tables import open_parquet

SEPARATORS = (",", ";", "\t", "|")
CLOCK_WORDS = frozenset(["t", "time", "timestamp", "stamp", "datetime", "date"])
"""A column with one of these words in its name may say the time."""
FRAME_WORDS = frozenset(["frame", "step", "row", "index"])
UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
EPOCH_S = 1e8
"""Times that are this many seconds since 1970, in one of the units, say which unit it is."""
FORWARD = 0.9
"""Share of the steps in which a clock goes forward."""
MOST_FILES = 50
"""Tables that are looked at; of more, those that come first."""


def look_at_csv(found: Found) -> Look:
    """Look at CSV files, and find out how they are written.

    Raises:
        TableError: one cannot be read.
    """
    options = _written_as(found.files[0])
    source: Any = CsvSource.model_construct(kind="csv", **options)
    look = _look("csv", found.files, (open_csv(path, source) for path in found.files[:MOST_FILES]), options)
    return _of_the_first(look, more=len(found.files) > MOST_FILES)


def look_at_parquet(found: Found) -> Look:
    """Look at Parquet files.

    Raises:
        TableError: one cannot be read.
    """
    look = _look("parquet", found.files, (_whole(path) for path in found.files[:MOST_FILES]), {})
    return _of_the_first(look, more=len(found.files) > MOST_FILES)


def look_at_lerobot(found: Found) -> Look:
    """Look at a LeRobot dataset, whose vectors have names.

    Raises:
        TableError: it is damaged.
    """
    source: Any = LerobotSource.model_construct(kind="lerobot", folder=str(found.files[0]))
    dataset = read_info(source)
    files = lerobot_files(dataset)
    look = _look("lerobot", found.files, (_whole(path) for path in files[:MOST_FILES]), {})
    known = {LEROBOT_EPISODE, FRAME, TIME, "index", "task_index"}
    fields = tuple(each for each in look.fields if each.field not in known)
    for each in fields:
        vector, _, place = each.field.rpartition("[")
        names = dataset.names.get(vector, ())
        if names and place.rstrip("]").isdecimal():
            each.field = f"{vector}[{names[int(place.rstrip(']'))]}]"
        each.rate_hz = dataset.fps
    return _of_the_first(replace(look, fields=fields), more=len(files) > MOST_FILES)


def look_at_minari(found: Found) -> Look:
    """Look at the first episodes of a Minari dataset.

    Raises:
        TableError: it is damaged, or Minari is not installed.
    """
    name = str(found.files[0])
    episodes = minari_episodes(name)
    some = enumerate(islice(episodes, MOST_FILES))
    look = _look("minari", found.files, (minari_table(f"{name}, episode {number}", each) for number, each in some), {})
    return _of_the_first(look, more=next(episodes, None) is not None)


def _whole(path: Path) -> Table:
    try:
        names = list(polars.read_parquet_schema(path))
    except (Exception, polars.exceptions.PanicException):
        names = []  # the next line says what is wrong
    return open_parquet(path, names)


def _of_the_first(look: Look, *, more: bool) -> Look:
    return replace(look, looked_at=MOST_FILES) if more else look


def _look(kind: Any, files: Sequence[Path], tables: Iterable[Table], options: dict[str, Any]) -> Look:
    fields = dict[str, Field]()
    clocks = dict[str, list[polars.Series]]()
    for table in tables:
        for name in table.names:
            for field, column in _leaves(name, table.column(name, plain_signal(name))):
                _take(fields.setdefault(field, Field(field, unit=unit_in(field))), column)
                if _words(field) & (CLOCK_WORDS | FRAME_WORDS):
                    clocks.setdefault(field, []).append(column)
    clock, rate = _clock(clocks) if kind in ("csv", "parquet") else (None, None)
    for each in fields.values():
        each.rate_hz = rate
    said = set(clock.values()) if clock else set()
    return Look(kind, tuple(files), tuple(each for each in fields.values() if each.field not in said),
                clock=clock, options=options)  # fmt: skip


def _leaves(field: str, column: polars.Series) -> Iterator[tuple[str, polars.Series]]:
    """Yield the parts of a column that are numbers, texts or times, under how `source` names them."""
    match column.dtype:
        case polars.Struct():
            for part in column.struct.fields:
                yield from _leaves(f"{field}.{part}", column.struct.field(part))
        case polars.List() | polars.Array():
            lists = column.arr.to_list() if isinstance(column.dtype, polars.Array) else column
            longest = lists.list.len().max()
            if isinstance(longest, int) and 0 < longest <= LONGEST_ARRAY:
                for place in range(longest):
                    yield from _leaves(f"{field}[{place}]", lists.list.get(place, null_on_oob=True))
        case _:
            yield field, column


def _take(found: Field, column: polars.Series) -> None:
    found.total += len(column)
    if isinstance(column.dtype, polars.Categorical | polars.Enum):
        column = column.cast(polars.String)
    some = column.gather_every(max(1, len(column) // MOST_VALUES)) if len(column) else column
    if some.dtype.is_numeric() or some.dtype == polars.Boolean:
        numbers = column.cast(polars.Float64).to_numpy()
        numbers = numbers[np.isfinite(numbers)]
        if len(numbers):
            low, high = found.extent or (np.inf, -np.inf)
            found.extent = (min(low, float(numbers.min())), max(high, float(numbers.max())))
        found.values.extend(some.cast(polars.Float64).fill_null(np.nan).to_list())
    elif some.dtype == polars.String:
        found.values.extend([np.nan] * len(some))
        for text in some.drop_nulls().to_list():
            if text in found.texts or len(found.texts) <= MOST_TEXTS:
                found.texts[text] = found.texts.get(text, 0) + 1


def _clock(candidates: dict[str, list[polars.Series]]) -> tuple[dict[str, Any] | None, float | None]:
    """Return the key `clock` for the column that says the time, and the rate; else for one that counts rows."""
    for field, columns in candidates.items():
        if not _words(field) & CLOCK_WORDS:
            continue
        unit, steps = _steps(field, columns)
        if len(steps) and (steps > 0).mean() >= FORWARD:
            period = usual_period(steps[steps > 0])
            return {"column": field, **({} if unit == "s" else {"unit": unit})}, 1.0 / (period * UNITS[unit])
    for field, columns in candidates.items():
        if _words(field) & FRAME_WORDS and all(column.dtype.is_numeric() for column in columns):
            steps = np.concatenate([np.diff(column.drop_nulls().to_numpy()) for column in columns])
            if len(steps) and (steps == 1).mean() >= FORWARD:
                return {"frame": field}, None
    return None, None


def _steps(field: str, columns: Sequence[polars.Series]) -> tuple[str, np.ndarray]:
    """Return the unit of a time and the steps of it; none if it is no time."""
    numbers = []
    for column in columns:
        if column.dtype == polars.String:
            try:
                column = column.str.to_datetime(time_unit="ns", strict=False)
            except polars.exceptions.PolarsError:
                return "s", np.zeros(0)
        if isinstance(column.dtype, polars.Datetime):
            numbers.append(column.drop_nulls().dt.timestamp("ns").to_numpy() / 1e9)
            continue
        if not column.dtype.is_numeric():
            return "s", np.zeros(0)
        numbers.append(column.drop_nulls().cast(polars.Float64).to_numpy())
    steps = np.concatenate([np.diff(each) for each in numbers] or [np.zeros(0)])
    if any(not column.dtype.is_numeric() for column in columns):
        return "s", steps
    named = next((unit for unit in ("ns", "us", "ms", "s") if unit in _words(unit_in(field) or field)), None)
    largest = max((float(each.max()) for each in numbers if len(each)), default=0.0)
    since_1970 = next((unit for unit, size in UNITS.items() if EPOCH_S <= largest * size < 100 * EPOCH_S), None)
    return named or since_1970 or "s", steps


def _words(text: str) -> set[str]:
    return set(re.split(r"[^a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", text).lower()))


def _written_as(path: Path) -> dict[str, Any]:
    """Return how a CSV file is written, as keys of `source`, where it is not the default.

    Raises:
        TableError: the file cannot be read.
    """
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
            lines = [line for line in islice(file, 200) if line.strip()]
    except OSError as error:
        message = f"{path}: the file cannot be read ({error.strerror})"
        raise TableError(message) from error
    comment = lines[0][0] if lines and lines[0][0] in "#%" else None
    lines = [line for line in lines if comment is None or not line.startswith(comment)]
    if not lines:
        return {}
    counts = {each: len(next(csv.reader([lines[0]], delimiter=each))) for each in SEPARATORS}
    separator = max(SEPARATORS, key=lambda each: counts[each])
    cells = [cell for row in csv.reader(lines[1:], delimiter=separator) for cell in row]
    commas = sum(bool(re.fullmatch(r"\s*[+-]?\d+,\d+\s*", cell)) for cell in cells)
    points = sum(bool(re.fullmatch(r"\s*[+-]?\d+\.\d+\s*", cell)) for cell in cells)
    options: dict[str, Any] = {} if separator == "," else {"separator": separator}
    options |= {"decimal": ","} if separator != "," and commas > points else {}
    return options | ({"comment": comment} if comment else {})
