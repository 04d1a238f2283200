"""Samples from the MCAP logs of a recording: their topics brought to one clock, every loss counted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float64, Shaped

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.params.source import EpisodeByGap, EpisodeByReset, McapSource
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.clock import NONE, Follower, Ticks, TopicTimes, ticks
from addressed_dynamics.importing.paths import FieldPath
from addressed_dynamics.importing.samples import Recorded, Samples
from addressed_dynamics.importing.series import TopicReader, TopicSeries, Turns
from addressed_dynamics.importing.signals import Signals
from addressed_dynamics.importing.spool import BLOCK_ROWS, Spool
from addressed_dynamics.importing.topics import read_topics

SUMMED = ("messages", "not_finite", "backwards", "reordered", "unused", "held")
"""Counters of topics that are summed for a recording: messages read, with a value that is not finite, that stood behind
a later one, with names in another order, and that no tick used; and ticks that used the message of the tick before."""
FAST = 1.2
"""A clock that ticks so many times as fast as an observed topic speaks repeats its messages."""


def read_mcap(
    files: Sequence[Path], source: McapSource, signals: Signals, paths: Sequence[FieldPath], agreement: Agreement
) -> Recorded:
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
    samples = Spool(_sample_rows(len(signals.all)))
    on_clock = [_on_clock(where, part, source, signals, samples) for part in parts]
    topics = {
        reader.topic: _counts(reader, [part.topics[place] for part in on_clock]) for place, reader in enumerate(readers)
    }
    observed = {each.topic for each in parts[0] if _is_observed(each, signals)}
    counts = {name: sum(int(topic[name]) for topic in topics.values()) for name in SUMMED}
    ticks_in_all = sum(len(part.at) for part in on_clock)
    decompressed = sum(reader.decompressed for reader in readers)
    return Recorded(
        blocks=partial(_samples, samples),
        counts={
            **counts,
            **({"decompressed": decompressed} if decompressed else {}),
            "joined_files": len(files) - 1,
            "incomplete_parts": incomplete,
            "ticks": ticks_in_all,
            "late": ticks_in_all - len(samples),
        },
        details={
            "files": [path.as_posix() for path in files],
            "from_ns": on_clock[0].at.start_ns,
            "to_ns": on_clock[-1].at.last_ns,
            "encodings": {reader.topic: ", ".join(sorted(reader.encodings)) for reader in readers},
            "names": {path: names for reader in readers for path, names in reader.names.items()},
            "topics": topics,
            "warnings": [*_warnings(topics, observed, source.rate_hz), *_held_too_long(observed, source)],
        },
    )


@dataclass(frozen=True)
class _Topic:
    """What became of the messages of a topic in a part of a recording."""

    series: TopicSeries
    used: int
    """Messages of this part that count at some tick."""
    on_time: int
    """Ticks at which one counts."""
    late: int
    """Ticks at which none does."""


@dataclass(frozen=True)
class _Part:
    """A part of a recording, on one clock."""

    at: Ticks
    topics: tuple[_Topic, ...]


def _sample_rows(signals: int) -> np.dtype[Any]:
    return np.dtype([("time_ns", np.int64), ("follows", np.bool_), ("values", np.float64, (signals,))])


def _samples(samples: Spool) -> Iterator[Samples]:
    for rows in samples.blocks() if len(samples) else [np.empty(0, samples.row)]:
        ends = np.zeros(len(rows), dtype=np.bool_)
        yield Samples(rows["values"], rows["follows"], ends, {}, time_ns=rows["time_ns"])


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
    if before is None or before.last is None:
        return own
    series = own or TopicSeries(before.topic, before.signals, before.rows)
    series.hold(before.last)
    return series


def _on_clock(where: str, series: Sequence[TopicSeries], source: McapSource, signals: Signals, samples: Spool) -> _Part:
    """Bring the topics of a part to one clock, and add its samples to those of the parts before."""
    ages = [source.longest_age_ns(each.topic) for each in series]
    for each, age in zip(series, ages, strict=True):
        _check_order(where, each, round(source.tolerance_s * 1e9) if age is None else age)
    for each in series:
        _check_finite(where, each)
    ages = [
        None if set(each.signals) == {signals.label_column} else age for each, age in zip(series, ages, strict=True)
    ]
    at = ticks(where, [_times(each, signals, age) for each, age in zip(series, ages, strict=True)], source.rate_hz)
    followers = [_follower(each, age, source, signals) for each, age in zip(series, ages, strict=True)]
    on_time_before, marks_before = np.zeros(1, dtype=np.bool_), np.full((1, len(series) + 1), np.nan)
    for block in at.blocks(BLOCK_ROWS):
        newest = [each.at(block) for each in followers]
        on_time = np.all([each["number"] != NONE for each in newest], axis=0)
        rows = np.empty(len(block), _sample_rows(len(signals.all)))
        rows["time_ns"] = block
        for each, messages in zip(series, newest, strict=True):
            rows["values"][:, list(each.signals)] = messages["values"]
        marks = _marks(newest, rows["values"], signals)
        alike = (marks == np.concatenate([marks_before, marks[:-1]])).all(axis=1)
        rows["follows"] = alike & np.append(on_time_before, on_time[:-1])
        samples.append(rows[on_time])
        on_time_before, marks_before = on_time[-1:], marks[-1:]
    topics = tuple(
        _Topic(each, follower.used, len(at) - follower.late, follower.late)
        for each, follower in zip(series, followers, strict=True)
    )
    return _Part(at, topics)


def _follower(series: TopicSeries, age: int | None, source: McapSource, signals: Signals) -> Follower:
    longest_ns = None
    if isinstance(source.episode, EpisodeByGap) and _is_observed(series, signals):
        longest_ns = round(source.episode.seconds * 1e9)
    return Follower(series.messages(), len(series.signals), held=series.held, tolerance_ns=age, longest_ns=longest_ns)


def _marks(
    newest: Sequence[Shaped[np.ndarray, " tick"]], values: Float64[np.ndarray, "tick signal"], signals: Signals
) -> Float64[np.ndarray, "tick mark"]:
    """Return what stays the same within an episode: the silences of each topic so far, and the label."""
    label = np.zeros(len(values)) if signals.label_column is None else values[:, signals.label_column]
    return np.column_stack([*(each["silences"] for each in newest), label])


def _check_order(where: str, series: TopicSeries, tolerance_ns: int) -> None:
    if series.farthest_back_ns > tolerance_ns:
        message = (
            f"{where}: time goes backwards on topic {series.topic}, by up to {series.farthest_back_ns / 1e9:g} s in "
            f"{series.backwards} messages, which is more than the tolerance of {tolerance_ns / 1e9:g} s; if a "
            "simulation began again there, end episodes there with 'by: reset', else choose another 'time'"
        )
        raise LogError(message)


def _check_finite(where: str, series: TopicSeries) -> None:
    if series.finite or series.held is not None:
        return
    what = "see whether something is always missing, or other names stand beside its arrays than in the first file"
    if series.spoken.all():
        what = (
            "each field has one in some message, so several programs seem to write to the topic: take the fields of "
            "one of them, or record them on topics of their own"
        )
    messages = f"{series.not_finite} messages of topic {series.topic}"
    message = f"{where}: none of the {messages} has a finite value in all fields; {what}"
    raise LogError(message)


def _is_observed(series: TopicSeries, signals: Signals) -> bool:
    return min(series.signals) < len(signals.observation)


def _times(series: TopicSeries, signals: Signals, age: int | None) -> TopicTimes:
    # An observation that is held at the end of a log would be a state that nobody saw; a command does hold.
    holds = 0 if _is_observed(series, signals) and age is not None else age
    ends = int(np.iinfo(np.int64).max) if holds is None else series.last_ns + holds
    return TopicTimes(series.topic, series.first_ns, series.last_ns, ends)


def _counts(reader: TopicReader, topics: Sequence[_Topic]) -> dict[str, Any]:
    """Say what became of the messages of a topic in all parts."""
    not_finite, used = sum(each.series.not_finite for each in topics), sum(each.used for each in topics)
    rates = [rate for each in topics if (rate := each.series.rate_hz) is not None]
    return {
        "messages": len(reader),
        "not_finite": not_finite,
        "backwards": sum(each.series.backwards for each in topics),
        "reordered": reader.reordered,
        "used": used,
        "unused": len(reader) - not_finite - used,
        "held": sum(each.on_time for each in topics) - used,
        "late": sum(each.late for each in topics),
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
