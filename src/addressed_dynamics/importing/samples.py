"""What every source ends in: samples on one clock; and the episodes that they make."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction, SpaceSpec, Transitions
from addressed_dynamics.importing.signals import Signals

EPISODES_PER_FILE = 1_000_000
"""Room in the numbering of episodes: the 17th episode of file 2 is 2_000_016 (files from 0)."""


@dataclass(frozen=True)
class Samples:
    """The samples of one file; those that cannot be used are left out."""

    values: Float64[np.ndarray, "sample signal"]
    """The signals in the order of `Signals.all`; finite also in float32."""
    follows: Bool[np.ndarray, " sample"]
    """The sample is one step after the sample before it, in the same episode."""
    terminated: Bool[np.ndarray, " sample"]
    """The step that leads to the sample ended the episode for a reason inside the task."""
    counts: dict[str, int]
    """What was read, and how much of it was not used or used twice, by the name of a counter."""
    details: dict[str, Any] = field(default_factory=dict)
    """The same by topic, and whatever else is worth knowing; JSON-compatible."""
    time_ns: Int64[np.ndarray, " sample"] | None = None
    """When each was logged, in nanoseconds; None if nothing says it."""


@dataclass(frozen=True)
class Episodes:
    """The episodes of one file."""

    slices: tuple[slice, ...]
    """The samples of each."""
    short: int
    """Episodes that were dropped because they are too short."""
    short_samples: int
    """Samples in them."""


def usable(values: Float64[np.ndarray, "row signal"]) -> Bool[np.ndarray, " row"]:
    """Say which rows can be kept: logs hold float32, so what is not finite there counts as not finite."""
    with np.errstate(over="ignore"):
        finite = np.isfinite(values.astype(np.float32))
    return np.asarray(finite.all(axis=1))


def keep_usable(
    values: Float64[np.ndarray, "row signal"],
    breaks: Bool[np.ndarray, " row"],
    *,
    terminated: Bool[np.ndarray, " row"] | None = None,
    unusable: Bool[np.ndarray, " row"] | None = None,
) -> Samples:
    """Drop the rows with a value that is not finite, and count them.

    Args:
        values: the signals of each row.
        breaks: the row begins an episode.
        terminated: as in `Samples`; nowhere if it is not given.
        unusable: rows that are dropped and counted whatever their values are.
    """
    kept = usable(values)
    if unusable is not None:
        kept &= ~unusable
    breaks = breaks.copy()
    breaks[1:] |= ~kept[:-1]
    ends = np.zeros(len(values), dtype=np.bool_) if terminated is None else terminated
    counts = {"rows": len(values), "not_finite": int((~kept).sum())}
    return Samples(values[kept], ~breaks[kept], ends[kept], counts)


def with_ends(samples: Samples, signals: Signals) -> Samples:
    """Let episodes end where `terminated` or `truncated` is not 0; what follows is another episode."""
    columns = [each for each in (signals.terminated_column, signals.truncated_column) if each is not None]
    if not columns:
        return samples
    last = (samples.values[:, columns] != 0).any(axis=1)
    follows = samples.follows.copy()
    follows[1:] &= ~last[:-1]
    terminated = samples.terminated.copy()
    if signals.terminated_column is not None:
        terminated |= samples.values[:, signals.terminated_column] != 0
    return replace(samples, follows=follows, terminated=terminated)


def without_offsets(samples: Samples, signals: Signals) -> Samples:
    """Take off each dimension what the params take off it."""
    return replace(samples, values=samples.values - signals.offsets) if signals.offsets.any() else samples


def find_episodes(follows: Bool[np.ndarray, " sample"], min_length: int) -> Episodes:
    """Cut samples into episodes, and drop those with fewer than `min_length` samples."""
    starts = np.flatnonzero(~follows)
    stops = np.append(starts[1:], len(follows))
    every = [slice(int(start), int(stop)) for start, stop in zip(starts, stops[: len(starts)], strict=True)]
    kept = tuple(each for each in every if each.stop - each.start >= min_length)
    return Episodes(
        slices=kept,
        short=len(every) - len(kept),
        short_samples=len(follows) - sum(each.stop - each.start for each in kept),
    )


def out_of_range(values: Float64[np.ndarray, "sample signal"], spec: SpaceSpec) -> dict[str, int]:
    """Count the samples outside the bounds of each dimension but the number of a discrete action; zeros left out."""
    counts = {
        each.name: int(((column < each.dimension.low) | (column > each.dimension.high)).sum())
        for each, column in ((each, values[:, each.column]) for each in dimension_columns(spec))
    }
    return {name: count for name, count in counts.items() if count}


@dataclass(frozen=True)
class DimensionColumn:
    """Where a dimension stands in `Samples.values`."""

    name: str
    """Its name with its role: `observation.angle`."""
    dimension: Dimension
    column: int


def dimension_columns(spec: SpaceSpec) -> list[DimensionColumn]:
    """Return the dimensions of observation, continuous action and exogenous inputs, and their columns."""
    # The number of a discrete action has a column, too.
    action: tuple[Dimension | None, ...] = (None,)
    if not isinstance(spec.action, DiscreteAction):
        action = spec.action.dimensions
    columns = [
        *(("observation", each) for each in spec.observation),
        *(("action", each) for each in action),
        *(("exogenous", each) for each in spec.exogenous),
    ]
    return [
        DimensionColumn(f"{role}.{each.name}", each, column)
        for column, (role, each) in enumerate(columns)
        if each is not None
    ]


def make_transitions(samples: Samples, episodes: Episodes, signals: Signals, first_episode: int) -> Transitions:
    """Make transitions of the episodes: K samples are K - 1 steps, and the action of the last sample is not used.

    The exogenous inputs of a step are those that stand beside its action, and so is its reward, 0 if there is none. The
    last step of an episode is
    truncated unless it is terminated. Time is simulated: it counts the steps of the file.
    """
    before = _rows([slice(each.start, each.stop - 1) for each in episodes.slices])
    lengths = np.array([each.stop - each.start - 1 for each in episodes.slices], dtype=np.int64)
    last = np.zeros(len(before), dtype=np.bool_)
    last[np.cumsum(lengths) - 1] = True
    values = samples.values
    observation = values[:, signals.observation_columns].astype(np.float32)
    action = values[before, signals.action_columns]
    discrete = isinstance(signals.spec.action, DiscreteAction)
    reward = np.zeros(len(before)) if signals.reward_column is None else values[before, signals.reward_column]
    terminated = last & samples.terminated[before + 1]
    steps = np.arange(len(before), dtype=np.int64)
    return Transitions(
        spec=signals.spec,
        episode=np.repeat(first_episode + np.arange(len(lengths), dtype=np.int64), lengths),
        step=_rows([slice(0, int(length)) for length in lengths]).astype(np.int32),
        time_ns=np.rint(steps * (signals.spec.step_seconds * 1e9)).astype(np.int64),
        observation=observation[before],
        action=action[:, 0].astype(np.int64) if discrete else action.astype(np.float32),
        reward=reward.astype(np.float32),
        next_observation=observation[before + 1],
        terminated=terminated,
        truncated=last & ~terminated,
        exogenous=values[before, signals.exogenous_columns].astype(np.float32),
    )


def _rows(slices: list[slice]) -> Int64[np.ndarray, " row"]:
    ranges = [np.arange(each.start, each.stop, dtype=np.int64) for each in slices]
    return np.concatenate([np.zeros(0, dtype=np.int64), *ranges])
