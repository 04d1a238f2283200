"""What every source ends in: samples on one clock; and the episodes that they make."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float64, Int64

from addressed_dynamics.episodes.transitions import DiscreteAction, SpaceSpec, Transitions
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
    # That number has a column too, without bounds.
    action = (None,) if isinstance(spec.action, DiscreteAction) else spec.action.dimensions
    dimensions = [
        *(("observation", each) for each in spec.observation),
        *(("action", each) for each in action),
        *(("exogenous", each) for each in spec.exogenous),
    ]
    counts = {
        f"{role}.{each.name}": int(((column < each.low) | (column > each.high)).sum())
        for (role, each), column in zip(dimensions, values.T, strict=False)
        if each is not None
    }
    return {name: count for name, count in counts.items() if count}


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
