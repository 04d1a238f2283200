"""Where one file ends and the next begins: episodes that stand in two files become one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from addressed_dynamics.importing.rows import Clock, Rows, ended, new_episodes, one_period
from addressed_dynamics.importing.signals import Signals


@dataclass(frozen=True)
class FileRows:
    """The rows of a file, with those that its last episode has in the files after it."""

    origin: str
    """The file."""
    rows: Rows
    counts: dict[str, int] = field(default_factory=dict)
    """`joined`: how often its last episode goes on in a next file; `unjoined`: its first one may go on from the file
    before, but nothing shows it; `gaps`: its first one does, after a gap. What is 0 is left out."""
    details: dict[str, Any] = field(default_factory=dict)
    """Which files these are."""


def join_seams(files: Iterable[FileRows], signals: Signals, clocks: tuple[Clock, ...]) -> Iterator[FileRows]:
    """Move the rows with which an episode goes on in a next file to the file in which it begins.

    It goes on if it did not end, its label stays the same and the clocks go on by one period. Without a clock the
    labels have to show that they are numbered over all files: another label came before, and none came back.
    """
    numbering = _Numbering(signals)
    waiting: list[FileRows] = []  # the file whose last episode may go on, and those that are wholly part of it
    for file in files:
        rows, counts, details = file.rows, dict(file.counts), dict(file.details)
        over_files = numbering.goes_over_files(rows)
        if waiting and _may_go_on(waiting[0].rows, rows, signals):
            first = waiting[0]
            how = _how(first.rows, rows, clocks) if clocks else over_files
            if how == "joined":
                length = _first_episode(rows, signals)
                head, rows = rows.select(slice(length)), rows.select(slice(length, None))
                waiting[0] = replace(
                    first,
                    rows=first.rows.followed_by(head),
                    counts=first.counts | {"joined": first.counts.get("joined", 0) + 1},
                    details={**first.details, "joined": {**first.details.get("joined", {}), file.origin: length}},
                )
            elif how:
                counts |= {how: 1}
                details |= {how: first.origin} if how == "unjoined" else {}
        current = FileRows(file.origin, rows, counts, details)
        if waiting and not len(rows) and len(file.rows):
            waiting.append(current)
            continue
        yield from waiting
        waiting = [current]
    yield from waiting


class _Numbering:
    """Finds out whether labels are numbered over all files, or anew in each."""

    def __init__(self, signals: Signals) -> None:
        self._column = signals.label_column
        self._seen: set[float] = set()
        self._last = np.nan
        self._anew = False

    def goes_over_files(self, rows: Rows) -> str:
        """Look at the next file, and say what becomes of an episode at its beginning that has the last label so far."""
        if self._column is None:
            return "unjoined"
        labels = rows.values[:, self._column]
        known = {float(label) for label in labels[~np.isnan(labels)]}
        seam = {self._last} if len(labels) and labels[0] == self._last else set()
        self._anew |= bool(known & self._seen - seam)
        others = self._seen - seam
        self._seen |= known
        self._last = float(labels[-1]) if len(labels) else np.nan
        if self._anew:
            return ""
        return "joined" if others else "unjoined"


def _may_go_on(before: Rows, after: Rows, signals: Signals) -> bool:
    if not len(before) or not len(after) or ended(before, signals)[-1]:
        return False
    column = signals.label_column
    return column is None or bool(before.values[-1, column] == after.values[0, column])


def _how(before: Rows, after: Rows, clocks: tuple[Clock, ...]) -> str:
    step = after.ticks[:1] - before.ticks[-1:]
    repeated = not step.any() and np.array_equal(before.values[-1], after.values[0], equal_nan=True)
    if repeated or one_period(step, clocks)[0]:
        return "joined"
    return "gaps" if (step > 0).all() else ""


def _first_episode(rows: Rows, signals: Signals) -> int:
    """Return how many rows the first episode has."""
    return int(np.append(np.flatnonzero(new_episodes(rows, signals)[1:]) + 1, len(rows))[0])
