"""Samples from the MCAP logs of a recording: their topics brought to one clock, every loss counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.params.source import EpisodeByGap, EpisodeByReset, McapSource
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.clock import NONE, TopicTimes, newest, silences, ticks
from addressed_dynamics.importing.paths import FieldPath
from addressed_dynamics.importing.samples import Samples, usable
from addressed_dynamics.importing.series import TopicReader, TopicSeries, Turns
from addressed_dynamics.importing.signals import Signals
from addressed_dynamics.importing.topics import read_topics

SUMMED = ("messages", "not_finite", "backwards", "reordered", "unused", "held")
"""Counters of topics that are summed for a recording: messages read, with a value that is not finite, that stood behind
a later one, with names in another order, and that no tick used; and ticks that used the message of the tick before."""
BEFORE = np.iinfo(np.int64).min // 2
"""The time of a message that holds from a part before; a long way from where a time could overflow."""
FAST = 1.2
"""A clock that ticks so many times as fast as an observed topic speaks repeats its messages."""


def read_mcap(
    files: Sequence[Path], source: McapSource, signals: Signals, paths: Sequence[FieldPath], agreement: Agreement
) -> Samples:
    """Read the logs of a recording and bring its topics to one clock.

    The clock ticks from when all topics have spoken until an observed topic falls silent for good, or the tolerance
    after another has. At each tick the newest value of each topic holds if it is not older than the tolerance (the
    label of an episode, and what is held: however old it is); a tick at which one is older is dropped, and what follows
    is another episode. Messages with a value that is missing or not finite are ignored.

    Args:
        files: MCAP logs or databases of ROS 2, in the order of their times.
        source: how to read them.
        signals: what to read.
        paths: where each of `signals.all` is.
        agreement: what the files before these looked like.

    Raises:
        LogError: a file is damaged, or the recording lacks a topic or a field, has topics that never overlap in time,
            or has messages that stand behind later ones by more than the tolerance.
    """
    where = str(files[0])
    turns = Turns(round(source.tolerance_s * 1e9) if isinstance(source.episode, EpisodeByReset) else None)
    readers = read_topics(
        files, signals.all, paths, clock=source.clock, turns=turns, types=source.types, agreement=agreement
    )
    parts, incomplete = _parts(where, [reader.series() for reader in readers], source)
    on_clock = [_on_clock(where, part, source, signals) for part in parts]
    topics = {
        reader.topic: _counts(reader, [part.topics[place] for part in on_clock]) for place, reader in enumerate(readers)
    }
    observed = {each.topic for each in parts[0] if _is_observed(each, signals)}
    counts = {name: sum(int(topic[name]) for topic in topics.values()) for name in SUMMED}
    ticks_in_all = sum(len(part.at) for part in on_clock)
    decompressed = sum(reader.decompressed for reader in readers)
    return Samples(
        values=np.concatenate([part.values for part in on_clock]),
        follows=np.concatenate([part.follows for part in on_clock]),
        time_ns=np.concatenate([part.time_ns for part in on_clock]),
        terminated=np.zeros(sum(len(part.follows) for part in on_clock), dtype=np.bool_),
        counts={
            **counts,
            **({"decompressed": decompressed} if decompressed else {}),
            "joined_files": len(files) - 1,
            "incomplete_parts": incomplete,
            "ticks": ticks_in_all,
            "late": ticks_in_all - sum(len(part.follows) for part in on_clock),
        },
        details={
            "files": [path.as_posix() for path in files],
            "from_ns": int(on_clock[0].at[0]),
            "to_ns": int(on_clock[-1].at[-1]),
            "encodings": {reader.topic: ", ".join(sorted(reader.encodings)) for reader in readers},
            "names": {path: names for reader in readers for path, names in reader.names.items()},
            "topics": topics,
            "warnings": [*_warnings(topics, observed, source.rate_hz), *_held_too_long(observed, source)],
        },
    )


@dataclass(frozen=True)
class _Topic:
    """What became of the messages of a topic in a part of a recording."""

    read: TopicSeries
    sound: TopicSeries
    """Those with finite values."""
    chosen: Int64[np.ndarray, " tick"]
    """The message that counts at each tick; none is `NONE`."""

    @property
    def used(self) -> int:
        """Messages of this part that count at some tick."""
        used = np.unique(self.chosen[self.chosen != NONE])
        return int((self.sound.time_ns[used] != BEFORE).sum())


@dataclass(frozen=True)
class _Part:
    """A part of a recording, on one clock."""

    at: Int64[np.ndarray, " tick"]
    topics: tuple[_Topic, ...]
    values: Float64[np.ndarray, "sample signal"]
    """The signals at the ticks at which none is late."""
    follows: Bool[np.ndarray, " sample"]
    time_ns: Int64[np.ndarray, " sample"]


def _parts(
    where: str, series: Sequence[Mapping[int, TopicSeries]], source: McapSource
) -> tuple[list[list[TopicSeries]], int]:
    """Return the series of all topics for each part of a recording, and the number of parts in which one is silent."""
    found, incomplete = list[list[TopicSeries]](), 0
    held = dict[str, TopicSeries]()
    for part in sorted({part for each in series for part in each}):
        whole = list[TopicSeries]()
        for each in series:
            topic, own = next(iter(each.values())).topic, each.get(part)
            if source.longest_age_ns(topic) is None:
                own = _held_on(held.get(topic), own)
                held |= {topic: own} if own is not None else {}
            whole += [own] if own is not None else []
        if len(whole) == len(series):
            found.append(whole)
        else:
            incomplete += 1
    if not found:
        message = (
            f"{where}: in none of the {incomplete} parts between which time goes back has every topic spoken; "
            "give those that speak once 'hold: true' under 'topics'"
        )
        raise LogError(message)
    return found, incomplete


def _held_on(before: TopicSeries | None, own: TopicSeries | None) -> TopicSeries | None:
    """Let the last message of the parts before hold at the beginning of this one."""
    if before is None:
        return own
    first = replace(before, time_ns=np.array([BEFORE]), values=before.values[-1:], backwards=0, farthest_back_ns=0)
    if own is None:
        return first
    return replace(
        own,
        time_ns=np.concatenate([first.time_ns, own.time_ns]),
        values=np.concatenate([first.values, own.values]),
    )


def _on_clock(where: str, series: Sequence[TopicSeries], source: McapSource, signals: Signals) -> _Part:
    ages = [source.longest_age_ns(each.topic) for each in series]
    for each, age in zip(series, ages, strict=True):
        _check_order(where, each, round(source.tolerance_s * 1e9) if age is None else age)
    sound = [_finite(where, each) for each in series]
    ages = [None if set(each.signals) == {signals.label_column} else age for each, age in zip(sound, ages, strict=True)]
    at = ticks(where, [_times(each, signals, age) for each, age in zip(sound, ages, strict=True)], source.rate_hz)
    chosen = [newest(at, each.time_ns, age) for each, age in zip(sound, ages, strict=True)]
    on_time = np.all([each != NONE for each in chosen], axis=0)
    values = np.full((len(at), len(signals.all)), np.nan)
    for each, messages in zip(sound, chosen, strict=True):
        values[:, list(each.signals)] = each.values[messages]
    breaks = np.append(True, ~on_time[:-1]) | _label_changes(values, signals)
    if isinstance(source.episode, EpisodeByGap):
        longest_ns = round(source.episode.seconds * 1e9)
        for each, messages in zip(sound, chosen, strict=True):
            if _is_observed(each, signals):
                breaks |= silences(messages, each.time_ns, longest_ns)
    topics = tuple(_Topic(*each) for each in zip(series, sound, chosen, strict=True))
    return _Part(at, topics, values[on_time], ~breaks[on_time], at[on_time])


def _check_order(where: str, series: TopicSeries, tolerance_ns: int) -> None:
    if series.farthest_back_ns > tolerance_ns:
        message = (
            f"{where}: time goes backwards on topic {series.topic}, by up to {series.farthest_back_ns / 1e9:g} s in "
            f"{series.backwards} messages, which is more than the tolerance of {tolerance_ns / 1e9:g} s; if a "
            "simulation began again there, end episodes there with 'by: reset', else choose another 'time'"
        )
        raise LogError(message)


def _finite(where: str, series: TopicSeries) -> TopicSeries:
    kept = usable(series.values)
    if kept.all():
        return series
    if not kept.any():
        what = "see whether something is always missing, or other names stand beside its arrays than in the first file"
        if np.isfinite(series.values).any(axis=0).all():
            what = (
                "each field has one in some message, so several programs seem to write to the topic: take the fields "
                "of one of them, or record them on topics of their own"
            )
        message = (
            f"{where}: none of the {len(kept)} messages of topic {series.topic} has a finite value in all fields; "
            f"{what}"
        )
        raise LogError(message)
    return replace(series, time_ns=series.time_ns[kept], values=series.values[kept])


def _is_observed(series: TopicSeries, signals: Signals) -> bool:
    return min(series.signals) < len(signals.observation)


def _times(series: TopicSeries, signals: Signals, age: int | None) -> TopicTimes:
    # An observation that is held at the end of a log would be a state that nobody saw; a command does hold.
    holds = 0 if _is_observed(series, signals) and age is not None else age
    ends = np.iinfo(np.int64).max if holds is None else int(series.time_ns[-1]) + holds
    return TopicTimes(series.topic, series.time_ns, int(ends))


def _label_changes(values: Float64[np.ndarray, "tick signal"], signals: Signals) -> Bool[np.ndarray, " tick"]:
    if signals.label_column is None:
        return np.zeros(len(values), dtype=np.bool_)
    label = values[:, signals.label_column]
    return np.append(True, label[1:] != label[:-1])


def _counts(reader: TopicReader, topics: Sequence[_Topic]) -> dict[str, Any]:
    """Say what became of the messages of a topic in all parts."""
    not_finite = sum(len(each.read.time_ns) - len(each.sound.time_ns) for each in topics)
    used = sum(each.used for each in topics)
    on_time = sum(int((each.chosen != NONE).sum()) for each in topics)
    rates = [rate for each in topics if (rate := each.sound.rate_hz) is not None]
    return {
        "messages": len(reader),
        "not_finite": not_finite,
        "backwards": sum(each.read.backwards for each in topics),
        "reordered": reader.reordered,
        "used": used,
        "unused": len(reader) - not_finite - used,
        "held": on_time - used,
        "late": sum(int((each.chosen == NONE).sum()) for each in topics),
        "measured_hz": float(np.median(rates)) if rates else None,
    }


def _held_too_long(observed: Set[str], source: McapSource) -> list[str]:
    """Say which observed topics hold on for longer than the silence that ends an episode."""
    if not isinstance(source.episode, EpisodeByGap):
        return []
    ages = {topic: source.longest_age_ns(topic) for topic in sorted(observed)}
    return [
        f"{topic} holds {'for ever' if age is None else f'for {age / 1e9:g} s'}, but a silence of "
        f"{source.episode.seconds:g} s ends an episode: episodes end with states that nobody saw; lower its tolerance"
        for topic, age in ages.items()
        if age is None or age > round(source.episode.seconds * 1e9)
    ]


def _warnings(topics: Mapping[str, Mapping[str, Any]], observed: Set[str], rate_hz: float) -> list[str]:
    """Say which observed topics speak far more seldom than the clock ticks."""
    return [
        f"the clock ticks at {rate_hz:g} Hz, but {name} has {counts['measured_hz']:.3g} messages a second: "
        f"{counts['held']:,} samples repeat the one before; lower rate_hz"
        for name, counts in topics.items()
        if name in observed and (counts["measured_hz"] or np.inf) * FAST < rate_hz
    ]
