"""Samples from an MCAP log: its topics brought to one clock, every loss counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.base.params.source import EpisodeByGap, McapSource
from addressed_dynamics.importing.agreement import Agreement
from addressed_dynamics.importing.clock import NONE, TopicTimes, newest, silences, ticks
from addressed_dynamics.importing.paths import FieldPath
from addressed_dynamics.importing.samples import Samples, usable
from addressed_dynamics.importing.series import TopicSeries
from addressed_dynamics.importing.signals import Signals
from addressed_dynamics.importing.topics import read_topics

SUMMED = ("messages", "not_finite", "backwards", "unused", "held")
"""Counters of topics that are summed for a file: messages read, with a value that is not finite, that stood behind a
later one, and that no tick used; and ticks that used the message of the tick before again."""


def read_mcap(
    path: Path, source: McapSource, signals: Signals, paths: list[FieldPath], agreement: Agreement
) -> Samples:
    """Read the log at `path` and bring its topics to one clock.

    The clock ticks from when all topics have spoken until an observed topic falls silent for good, or the tolerance
    after another has. At each tick the newest value of each topic holds if it is not older than the tolerance (the
    label of an episode: however old it is); a tick at which one is older is dropped, and what follows is another
    episode. Messages with a value that is missing or not finite are ignored.

    Args:
        path: an MCAP log.
        source: how to read it.
        signals: what to read.
        paths: where each of `signals.all` is.
        agreement: what the files before this one looked like.

    Raises:
        LogError: the file is damaged, lacks a topic or a field, has topics that never overlap in time, or has
            messages that stand behind later ones by more than the tolerance.
    """
    tolerance_ns = round(source.tolerance_s * 1e9)
    series = read_topics(path, signals.all, paths, time=source.time, agreement=agreement)
    for each in series:
        _check_order(path, each, tolerance_ns)
    sound = [_finite(path, each) for each in series]
    ages = [None if set(each.signals) == {signals.label_column} else tolerance_ns for each in sound]
    at = ticks(str(path), [_times(each, signals, age) for each, age in zip(sound, ages, strict=True)], source.rate_hz)
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
    return Samples(
        values=values[on_time],
        follows=~breaks[on_time],
        terminated=np.zeros(on_time.sum(), dtype=np.bool_),
        **_account(series, sound, chosen, at, on_time),
    )


def _account(
    series: Sequence[TopicSeries],
    sound: Sequence[TopicSeries],
    chosen: Sequence[Int64[np.ndarray, " tick"]],
    at: Int64[np.ndarray, " tick"],
    on_time: Bool[np.ndarray, " tick"],
) -> dict[str, Any]:
    topics = {
        each.topic: _topic_counts(each, kept, messages)
        for each, kept, messages in zip(series, sound, chosen, strict=True)
    }
    counts = {name: sum(topic[name] for topic in topics.values()) for name in SUMMED}
    encodings = {each.topic: ", ".join(each.encodings) for each in series}
    return {
        "counts": counts | {"ticks": len(at), "late": int((~on_time).sum())},
        "details": {"from_ns": int(at[0]), "to_ns": int(at[-1]), "encodings": encodings, "topics": topics},
    }


def _check_order(path: Path, series: TopicSeries, tolerance_ns: int) -> None:
    if series.farthest_back_ns > tolerance_ns:
        message = (
            f"{path}: time goes backwards on topic {series.topic}, by up to {series.farthest_back_ns / 1e9:g} s in "
            f"{series.backwards} messages, which is more than the tolerance of {tolerance_ns / 1e9:g} s; "
            "cut the file where its clock was set, or choose another 'time'"
        )
        raise LogError(message)


def _finite(path: Path, series: TopicSeries) -> TopicSeries:
    kept = usable(series.values)
    if not kept.any():
        message = f"{path}: none of the {len(kept)} messages of topic {series.topic} has a finite value in all fields"
        raise LogError(message)
    return replace(series, time_ns=series.time_ns[kept], values=series.values[kept])


def _is_observed(series: TopicSeries, signals: Signals) -> bool:
    return min(series.signals) < len(signals.observation)


def _times(series: TopicSeries, signals: Signals, age: int | None) -> TopicTimes:
    # An observation that is held at the end of a log would be a state that nobody saw; a command does hold.
    holds = 0 if _is_observed(series, signals) else age
    ends = np.iinfo(np.int64).max if holds is None else int(series.time_ns[-1]) + holds
    return TopicTimes(series.topic, series.time_ns, int(ends))


def _label_changes(values: Float64[np.ndarray, "tick signal"], signals: Signals) -> Bool[np.ndarray, " tick"]:
    if signals.label_column is None:
        return np.zeros(len(values), dtype=np.bool_)
    label = values[:, signals.label_column]
    return np.append(True, label[1:] != label[:-1])


def _topic_counts(read: TopicSeries, kept: TopicSeries, chosen: Int64[np.ndarray, " tick"]) -> dict[str, int]:
    on_time = chosen[chosen != NONE]
    used = len(np.unique(on_time))
    return {
        "messages": len(read.time_ns),
        "not_finite": len(read.time_ns) - len(kept.time_ns),
        "backwards": read.backwards,
        "used": used,
        "unused": len(kept.time_ns) - used,
        "held": len(on_time) - used,
        "late": int((chosen == NONE).sum()),
    }
