"""The findings of data quality, for people: what is wrong, how often, where first, and whether training can go on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.coverage import Occupancy
from addressed_dynamics.episodes.quality import Place, Quality, Tally
from addressed_dynamics.episodes.transitions import SpaceSpec

COVERED = 0.1
"""Share of the cells along a dimension that data should visit."""

MEANINGS = {
    "time_backwards": "steps at the time of the step before them or earlier",
    "gap": "gaps in time inside an episode",
    "jitter": "steps that are not one time step long",
    "stuck": "constant over the whole recording",
    "stuck_episode": "episodes in which it never changes",
    "out_of_bounds": "values beyond its bounds",
    "outlier": "values far from all others",
    "duplicate": "transitions that repeat an earlier state and all its inputs",
    "coverage": "parts of its range without data",
    "non_finite": "readings that are not finite, dropped by the import",
    "off_rate": "files whose rows come at another rate than the one that was given; the value is the rate in Hz",
}
"""What each kind of finding counts, in the order of a report."""


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with the data."""

    kind: str
    """A key of `MEANINGS`."""
    dimension: str
    """The dimension that it is about, for instance `observation.position`; empty if it is about whole steps."""
    count: int
    """How often it was found; at least once."""
    of: int | None
    """Among how many; None if that is not known."""
    first: Place | None
    """Where it was found first; None for what has no place."""
    blocking: bool
    """Whether nothing useful can be trained on such data."""

    @property
    def sentence(self) -> str:
        """The finding in a line, for instance for an error."""
        subject = f"{self.dimension}: " if self.dimension else ""
        among = "" if self.of is None else f" of {self.of:,}"
        return f"{subject}{MEANINGS[self.kind]} ({self.count:,}{among}{self._place})"

    @property
    def _place(self) -> str:
        if self.first is None:
            return ""
        words = [self.first.log]
        words += [] if self.first.episode is None else [f"episode {self.first.episode}"]
        words += [] if self.first.step is None else [f"step {self.first.step}"]
        return f"; first in {', '.join(words)}"


def find(
    quality: Quality,
    spec: SpaceSpec,
    *,
    duplicates: Tally,
    occupancy: Occupancy,
    imported: Mapping[str, Mapping[str, int]],
    other_rates: Mapping[str, float] | None = None,
) -> list[Finding]:
    """Return all findings, in the order of `MEANINGS` and of the dimensions.

    Args:
        quality: what was counted in all logs.
        spec: what the dimensions are.
        duplicates: transitions that are equal to an earlier one.
        occupancy: which cells of the state space hold data.
        imported: counters of the import by file; none if the data was not imported.
        other_rates: measured rate of each imported file that has another one than the import was given, in Hz.
    """
    tallies = dict(quality.tallies)
    transitions = duplicates.of
    constant = {name for name, (low, high) in quality.ranges.items() if low == high}
    for name in quality.ranges:
        if name in constant:
            tallies["stuck", name] = Tally(transitions, transitions, None)
            # Said of the whole recording already.
            tallies.pop(("stuck_episode", name), None)
    tallies["duplicate", ""] = duplicates
    for name, cells in zip(spec.observation_names, occupancy.per_dimension, strict=True):
        key = f"observation.{name}"
        if key not in constant and cells.mean() < COVERED:
            tallies["coverage", key] = Tally(int(np.sum(~cells)), len(cells), None)
    states = {f"observation.{name}" for name in spec.observation_names}
    findings = [
        Finding(kind, name, tally.count, tally.of, tally.first, _blocks(kind, states <= constant))
        for (kind, name), tally in tallies.items()
        if tally.count
    ]
    findings += _non_finite(imported)
    if other_rates:
        name, rate = next(iter(other_rates.items()))
        findings.append(
            Finding("off_rate", "", len(other_rates), len(imported), Place(name, value=rate), blocking=False)
        )
    order = list(MEANINGS)
    return sorted(findings, key=lambda finding: order.index(finding.kind))


def findings_to_json(findings: Sequence[Finding]) -> list[dict[str, Any]]:
    """Return the findings as JSON-compatible values."""
    return [asdict(finding) | {"meaning": MEANINGS[finding.kind]} for finding in findings]


def refuse_useless(recording: Path, findings: Sequence[Finding]) -> None:
    """Do nothing if one can train on data with these findings.

    Raises:
        TableError: one cannot.
    """
    blocking = [finding for finding in findings if finding.blocking]
    if blocking:
        others = f" and {len(blocking) - 1} more such findings" if len(blocking) > 1 else ""
        message = f"{recording}: nothing can be learned from this data: {blocking[0].sentence}{others}; mend its source"
        raise TableError(message)


def _blocks(kind: str, nothing_moves: bool) -> bool:
    return kind == "time_backwards" or (kind == "stuck" and nothing_moves)


def _non_finite(imported: Mapping[str, Mapping[str, int]]) -> list[Finding]:
    """Collect what the import counted: transitions themselves cannot hold such values."""
    counts = {
        name: sum(count for counter, count in counters.items() if "finite" in counter or "nan" in counter.split("_"))
        for name, counters in imported.items()
    }
    found = [name for name, count in counts.items() if count]
    return [Finding("non_finite", "", sum(counts.values()), None, Place(found[0]), blocking=False)] if found else []
