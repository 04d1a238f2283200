"""What every source ends in: samples on one clock; and the episodes that they make."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Recorded:
    """The samples of one file or recording, in blocks, so that not all of them need to be in memory."""

    blocks: Callable[[], Iterator[Samples]]
    """Begins to go through them; done several times. A block's first sample may follow the last one of the block
    before. What was counted is not in the blocks but below."""
    counts: dict[str, int]
    """As in `Samples`."""
    details: dict[str, Any] = field(default_factory=dict)
    """As in `Samples`."""

    @staticmethod
    def of(samples: Samples) -> Recorded:
        """Return samples that are in memory as one block."""
        return Recorded(lambda: iter([samples]), samples.counts, samples.details)

    def whole(self) -> Samples:
        """Return all samples at once."""
        blocks = list(self.blocks())
        if len(blocks) == 1:
            return replace(blocks[0], counts=self.counts, details=self.details)
        times = [each.time_ns for each in blocks if each.time_ns is not None]
        return Samples(
            values=np.concatenate([each.values for each in blocks]),
            follows=np.concatenate([each.follows for each in blocks]),
            terminated=np.concatenate([each.terminated for each in blocks]),
            counts=self.counts,
            details=self.details,
            time_ns=np.concatenate(times) if times else None,
        )

    def overlapping(self) -> Iterator[Samples]:
        """Yield the blocks, each with the last sample of the one before it: every step is in one of them."""
        before: Samples | None = None
        for block in self.blocks():
            joined = (
                block
                if before is None
                else Samples(
                    values=np.concatenate([before.values[-1:], block.values]),
                    follows=np.concatenate([before.follows[-1:], block.follows]),
                    terminated=np.concatenate([before.terminated[-1:], block.terminated]),
                    counts={},
                )
            )
            yield joined
            before = joined


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


def with_ends(recorded: Recorded, signals: Signals) -> Recorded:
    """Let episodes end where `terminated` or `truncated` is not 0; what follows is another episode."""
    columns = [each for each in (signals.terminated_column, signals.truncated_column) if each is not None]
    if not columns:
        return recorded

    def blocks() -> Iterator[Samples]:
        ended = False
        for samples in recorded.blocks():
            last = np.append(ended, (samples.values[:, columns] != 0).any(axis=1))
            ended = bool(last[-1])
            terminated = samples.terminated
            if signals.terminated_column is not None:
                terminated = terminated | (samples.values[:, signals.terminated_column] != 0)
            yield replace(samples, follows=samples.follows & ~last[:-1], terminated=terminated)

    return replace(recorded, blocks=blocks)


def without_offsets(recorded: Recorded, signals: Signals) -> Recorded:
    """Take off each dimension what the params take off it."""
    if not signals.offsets.any():
        return recorded

    def blocks() -> Iterator[Samples]:
        for samples in recorded.blocks():
            yield replace(samples, values=samples.values - signals.offsets)

    return replace(recorded, blocks=blocks)


def find_episodes(recorded: Recorded, min_length: int) -> Episodes:
    """Cut samples into episodes, and drop those with fewer than `min_length` samples."""
    found, count = [np.zeros(0, dtype=np.int64)], 0
    for samples in recorded.blocks():
        found.append(np.flatnonzero(~samples.follows) + count)
        count += len(samples)
    starts = np.concatenate(found)
    stops = np.append(starts[1:], count)
    every = [slice(int(start), int(stop)) for start, stop in zip(starts, stops[: len(starts)], strict=True)]
    kept = tuple(each for each in every if each.stop - each.start >= min_length)
    return Episodes(
        slices=kept,
        short=len(every) - len(kept),
        short_samples=count - sum(each.stop - each.start for each in kept),
    )


def out_of_range(recorded: Recorded, spec: SpaceSpec) -> dict[str, int]:
    """Count the samples outside the bounds of each dimension but the number of a discrete action; zeros left out."""
    columns = dimension_columns(spec)
    counts = dict.fromkeys([each.name for each in columns], 0)
    for samples in recorded.blocks():
        for each in columns:
            values = samples.values[:, each.column]
            counts[each.name] += int(((values < each.dimension.low) | (values > each.dimension.high)).sum())
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


def transition_blocks(
    recorded: Recorded, episodes: Episodes, signals: Signals, first_episode: int
) -> Iterator[Transitions]:
    """Yield the transitions of the episodes: K samples are K - 1 steps, and the action of the last sample is not used.

    The exogenous inputs of a step are those that stand beside its action, and so is its reward, 0 if there is none. The
    last step of an episode is truncated unless it is terminated. Time is simulated: it counts the steps of the file.
    """
    starts = np.array([each.start for each in episodes.slices], dtype=np.int64)
    stops = np.array([each.stop for each in episodes.slices], dtype=np.int64)
    first_sample, first_step = 0, 0
    for samples in recorded.overlapping():
        # The sample that each step leads to, and its episode.
        after = np.arange(first_sample + 1, first_sample + len(samples))
        number = np.searchsorted(starts, after, side="left") - 1
        inside = (number >= 0) & (after < stops[number])
        after, number = after[inside], number[inside]
        if len(after):
            place = _Place(first_episode + number, after - 1 - starts[number], after == stops[number] - 1)
            yield _transitions(samples, after - 1 - first_sample, place, signals, first_step)
        first_sample, first_step = first_sample + max(len(samples) - 1, 0), first_step + len(after)


@dataclass(frozen=True)
class _Place:
    """Where steps stand."""

    episode: Int64[np.ndarray, " step"]
    step: Int64[np.ndarray, " step"]
    last: Bool[np.ndarray, " step"]


def _transitions(
    samples: Samples, before: Int64[np.ndarray, " step"], place: _Place, signals: Signals, first_step: int
) -> Transitions:
    values = samples.values
    observation = values[:, signals.observation_columns].astype(np.float32)
    action = values[before, signals.action_columns]
    discrete = isinstance(signals.spec.action, DiscreteAction)
    reward = np.zeros(len(before)) if signals.reward_column is None else values[before, signals.reward_column]
    terminated = place.last & samples.terminated[before + 1]
    steps = first_step + np.arange(len(before), dtype=np.int64)
    return Transitions(
        spec=signals.spec,
        episode=place.episode,
        step=place.step.astype(np.int32),
        time_ns=np.rint(steps * (signals.spec.step_seconds * 1e9)).astype(np.int64),
        observation=observation[before],
        action=action[:, 0].astype(np.int64) if discrete else action.astype(np.float32),
        reward=reward.astype(np.float32),
        next_observation=observation[before + 1],
        terminated=terminated,
        truncated=place.last & ~terminated,
        exogenous=values[before, signals.exogenous_columns].astype(np.float32),
    )
