"""Rows of tables on their way to samples: what their clock says, and which rows make an episode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.importing.clock import usual_period
from addressed_dynamics.importing.samples import Samples, keep_usable
from addressed_dynamics.importing.signals import Signals

EXACT = 1e-6
"""Part of a period that the rounding of times may make up."""
OFF_RATE = 0.05
"""Share of the rate by which the measured one may differ before it is counted."""


@dataclass(frozen=True)
class Clock:
    """One column that says when a row was recorded."""

    column: str
    tolerance: float
    """Periods by which a step may be longer or shorter."""
    period: float
    """What it shows in a period."""
    unit_seconds: float | None
    """What a unit of it is in seconds; None if it counts rows."""


@dataclass(frozen=True)
class Piece:
    """The rows of one file."""

    where: str
    """The file."""
    row: Callable[[int], str]
    """Says which row is at a place of the file."""


@dataclass(frozen=True)
class Rows:
    """Rows of a table in the order in which they stand, or of several that follow each other."""

    values: Float64[np.ndarray, "row signal"]
    """The signals in the order of `Signals.all`, NaN where one is missing."""
    ticks: Float64[np.ndarray, "row clock"]
    """What each clock shows, in periods; NaN where it is missing."""
    pieces: tuple[Piece, ...]
    """The files."""
    piece: Int64[np.ndarray, " row"]
    """Number of the file in which a row stands."""
    place: Int64[np.ndarray, " row"]
    """Its place there."""

    def __len__(self) -> int:
        return len(self.values)

    @staticmethod
    def of_file(
        values: Float64[np.ndarray, "row signal"], ticks: Float64[np.ndarray, "row clock"], piece: Piece
    ) -> Rows:
        """Return all rows of a file."""
        places = np.arange(len(values), dtype=np.int64)
        return Rows(values, ticks, (piece,), np.zeros_like(places), places)

    def select(self, kept: slice | Bool[np.ndarray, " row"]) -> Rows:
        """Return some of the rows."""
        return replace(
            self, values=self.values[kept], ticks=self.ticks[kept], piece=self.piece[kept], place=self.place[kept]
        )

    def followed_by(self, other: Rows) -> Rows:
        """Return these rows and then those of another file."""
        return Rows(
            np.concatenate([self.values, other.values]),
            np.concatenate([self.ticks, other.ticks]),
            (*self.pieces, *other.pieces),
            np.concatenate([self.piece, other.piece + len(self.pieces)]),
            np.concatenate([self.place, other.place]),
        )

    def found(self, row: int) -> str:
        """Say in which file a row stands, and where."""
        return f"{self.pieces[self.piece[row]].where}: {self.said(row)}"

    def said(self, row: int) -> str:
        """Say where in its file a row stands."""
        piece = self.pieces[self.piece[row]]
        said: str = piece.row(int(self.place[row]))
        return said


def ended(rows: Rows, signals: Signals) -> Bool[np.ndarray, " row"]:
    """Say which rows are the last of their episode, by `terminated` and `truncated`."""
    columns = [each for each in (signals.terminated_column, signals.truncated_column) if each is not None]
    flags = rows.values[:, columns]
    return np.asarray(((flags != 0) & ~np.isnan(flags)).any(axis=1))


def new_labels(rows: Rows, signals: Signals) -> Bool[np.ndarray, " row"]:
    """Say which rows have another label than the row before them, as the first one always has."""
    breaks = np.zeros(len(rows), dtype=np.bool_)
    breaks[:1] = True
    if signals.label_column is not None:
        label = rows.values[:, signals.label_column]
        breaks[1:] = label[1:] != label[:-1]
    return breaks


def samples_of(rows: Rows, signals: Signals, clocks: tuple[Clock, ...]) -> Samples:
    """Make samples of rows: a row that cannot be used, or a step that is not one period, begins another episode.

    Args:
        rows: the rows of a file, with those that an episode has in the next one.
        signals: what their values are.
        clocks: what their ticks are; without any, each row is one period after the one before.

    Raises:
        TableError: time does not go on inside an episode.
    """
    breaks = new_episodes(rows, signals)
    if not clocks:
        return keep_usable(rows.values, breaks)
    length = len(rows)
    repeated = np.append(False, _as_before(rows.values) & _as_before(rows.ticks))[:length]
    rows, breaks = rows.select(~repeated), breaks[~repeated]
    untimed = np.isnan(rows.ticks).any(axis=1)
    timed = np.flatnonzero(~untimed)
    episode = np.cumsum(breaks)[timed]
    steps = np.diff(rows.ticks[timed], axis=0)
    inside = episode[1:] == episode[:-1]
    _check_time_goes_on(rows, timed, inside, steps, clocks)
    pause = inside & ~one_period(steps, clocks)
    breaks[timed[1:][pause]] = True
    samples = keep_usable(rows.values, breaks, unusable=untimed)
    rate_hz, measured_hz = 1.0 / signals.spec.step_seconds, _measured_hz(steps[inside], clocks, signals)
    off_rate = measured_hz is not None and abs(measured_hz - rate_hz) > OFF_RATE * rate_hz
    counts = {
        "rows": length,
        "repeated": int(repeated.sum()),
        "not_finite": samples.counts["not_finite"],
        # Where rows without a time lie between, they are why the step is longer.
        "gaps": int((pause & (np.diff(timed) == 1)).sum()),
        "off_rate": int(off_rate),
    }
    details: dict[str, Any] = {} if measured_hz is None else {"measured_hz": measured_hz}
    if off_rate:
        details["warnings"] = [f"the rows come at {measured_hz:g} Hz, but rate_hz is {rate_hz:g}; correct it"]
    return replace(samples, counts=counts, details=details)


def new_episodes(rows: Rows, signals: Signals) -> Bool[np.ndarray, " row"]:
    """Say which rows begin an episode, as far as labels and ends say it."""
    breaks = new_labels(rows, signals)
    breaks[1:] |= ended(rows, signals)[:-1]
    return breaks


def one_period(steps: Float64[np.ndarray, "step clock"], clocks: tuple[Clock, ...]) -> Bool[np.ndarray, " step"]:
    """Say which steps are one period long by all clocks."""
    tolerances = np.array([clock.tolerance for clock in clocks])
    return np.asarray((np.abs(steps - 1.0) <= tolerances + EXACT).all(axis=1))


def check_together(rows: Rows, signals: Signals) -> None:
    """Do nothing if the rows of each episode of a file stand together.

    Raises:
        TableError: a label comes back after another one.
    """
    if signals.label is None or signals.label_column is None:
        return
    # A row without a label is dropped, and ends no episode that others would have to belong to.
    rows = rows.select(~np.isnan(rows.values[:, signals.label_column]))
    begins = np.flatnonzero(new_labels(rows, signals))
    _, first, inverse = np.unique(rows.values[begins, signals.label_column], return_index=True, return_inverse=True)
    again = begins[first[inverse] < np.arange(len(begins))]
    if len(again):
        before = begins[first[inverse][np.searchsorted(begins, again[0])]]
        message = (
            f"{rows.found(int(again[0]))}: a value of column '{signals.label.field}' comes back after another one; it "
            f"was there before ({rows.said(int(before))}), and so it is {len(again)} times; name another column, or "
            "give each run a file; a column that is true in the last row of an episode is a 'terminated', with "
            "episode: {by: end}"
        )
        raise TableError(message)


def _as_before(table: Float64[np.ndarray, "row column"]) -> Bool[np.ndarray, " step"]:
    """Say which rows equal the row before them; what is missing in both is equal."""
    before, after = table[:-1], table[1:]
    return np.asarray(((before == after) | (np.isnan(before) & np.isnan(after))).all(axis=1))


def _check_time_goes_on(
    rows: Rows,
    timed: Int64[np.ndarray, " timed"],
    inside: Bool[np.ndarray, " step"],
    steps: Float64[np.ndarray, "step clock"],
    clocks: tuple[Clock, ...],
) -> None:
    wrong = inside[:, None] & (steps <= 0)
    if not wrong.any():
        return
    step, number = (int(each[0]) for each in np.nonzero(wrong))
    before, after = int(timed[step]), int(timed[step + 1])
    clock = clocks[number]
    shown = [f"{rows.ticks[row, number] * clock.period:.12g}" for row in (before, after)]
    what = f"falls from {shown[0]} to" if steps[step, number] < 0 else "stays at"
    message = (
        f"{rows.found(after)}: column '{clock.column}' {what} {shown[1]} inside an episode, after {rows.said(before)}; "
        + (
            "name the column that separates the episodes, or give each run a file"
            if steps[step, number] < 0
            else "two rows of one time should be equal; take one out, or name a column with a finer time"
        )
    )
    raise TableError(message)


def _measured_hz(steps: Float64[np.ndarray, "step clock"], clocks: tuple[Clock, ...], signals: Signals) -> float | None:
    """Return the rate that the clock shows, to six digits; None without steps or a time."""
    times = [number for number, clock in enumerate(clocks) if clock.unit_seconds is not None]
    if not times or not len(steps):
        return None
    return float(f"{1.0 / (usual_period(steps[:, times[0]]) * signals.spec.step_seconds):.6g}")
