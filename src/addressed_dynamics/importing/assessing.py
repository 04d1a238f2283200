"""A trial of an import: nothing is written, and what would come out is judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.importing.importer import wanted_signals
from addressed_dynamics.importing.judging import (
    Delay,
    EpisodeJudgement,
    Excitation,
    Noise,
    Stretch,
    judge_all,
    judge_episodes,
    stretches,
)
from addressed_dynamics.importing.precision import Precision, lost_steps
from addressed_dynamics.importing.samples import find_episodes, out_of_range
from addressed_dynamics.importing.units import read_samples

MOST_SAMPLES = 200_000
"""Samples that delays and noise are judged on at most: those that come first."""


@dataclass(frozen=True)
class Assessment:
    """What an import would give."""

    episodes: tuple[EpisodeJudgement, ...]
    excitations: tuple[Excitation, ...]
    delays: tuple[Delay, ...]
    noises: tuple[Noise, ...]
    counts: Mapping[str, int]
    """What was read, dropped, filled or converted, over all recordings."""
    warnings: tuple[str, ...]
    """What looks wrong, in lines that begin with the file."""
    refusal: str | None = None
    """Which of them would refuse the import; None if none would."""

    @property
    def transitions(self) -> int:
        """Transitions that would be imported."""
        return sum(each.samples - 1 for each in self.episodes if each.verdict != "leave")

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values."""
        return asdict(self)


def assess(source: SourceParams) -> Assessment:
    """Read what `source` imports, and judge it; one recording is in memory at a time, and a sample of all.

    Raises:
        ParamsError: as in `import_logs`.
        LogError: as in `import_logs`; that there is no episode is no error here.
        TableError: as in `import_logs`.
    """
    signals = wanted_signals(source)
    step_seconds = signals.spec.step_seconds
    episodes, kept, counts, warnings = list[EpisodeJudgement](), list[Stretch](), dict[str, int](), list[str]()
    precision = Precision(signals)
    for origin, recorded in read_samples(source, signals):
        found = find_episodes(recorded, source.min_length)
        samples = recorded.whole()
        episodes += judge_episodes(
            origin, samples, found, signals, min_length=source.min_length, step_seconds=step_seconds
        )
        if sum(len(each.states) for each in kept) < MOST_SAMPLES:
            kept += stretches(samples, found, signals)
        outside = sum(out_of_range(recorded, signals.spec).values())
        lost = sum(precision.add(lost_steps(recorded, signals), origin).values())
        for name, count in (samples.counts | {"out_of_range": outside, "swallowed": lost}).items():
            counts[name] = counts.get(name, 0) + count
        warnings += [f"{origin}: {warning}" for warning in samples.details.get("warnings", [])]
    refusals = tuple(precision.refusals())
    excitations, delays, noises = judge_all(kept, signals) if kept else ([], [], [])
    return Assessment(
        episodes=tuple(episodes),
        excitations=tuple(excitations),
        delays=tuple(delays),
        noises=tuple(noises),
        counts=counts,
        warnings=(*warnings, *refusals),
        refusal=next(iter(refusals), None),
    )
