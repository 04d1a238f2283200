"""What is wrong with logged data, counted one log at a time: its clock, and values that are stuck or far off."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Shaped

from addressed_dynamics.episodes.statistics import Sample
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec, Transitions

JITTER = 0.1
"""Share of a time step by which the time between two steps may differ from it."""
GAP = 1.5
"""Time steps between two steps of an episode from which on data is missing between them."""
STUCK_STEPS = 20
"""A dimension that does not change in an episode of so many steps is stuck."""
OUTLIER_RANGES = 10.0
"""Interquartile ranges from the median beyond which a value is an outlier."""

Fences = Mapping[str, tuple[float, float]]
"""Lowest and highest value that is no outlier, by dimension."""


@dataclass(frozen=True)
class Place:
    """Where something was found."""

    log: str
    """Name of the log, or of the file that it was imported from."""
    episode: int | None = None
    """Its episode, if it is known."""
    step: int | None = None
    """The step in the episode; the state after the last step counts as one more."""
    value: float | None = None
    """What was found there: a value in the unit of its dimension, or a time in seconds."""


@dataclass(frozen=True)
class Tally:
    """How often something was found; tallies of parts merge into the tally of the whole."""

    count: int
    """How often."""
    of: int
    """Among how many."""
    first: Place | None
    """Where first; None if it was not found."""

    def merge(self, other: Tally) -> Tally:
        """Add what was found in the logs after these."""
        return Tally(self.count + other.count, self.of + other.of, self.first or other.first)


Tallies = dict[tuple[str, str], Tally]
"""Tallies by kind of finding and dimension."""


@dataclass(frozen=True)
class Quality:
    """What was found in some logs; the qualities of parts merge into the quality of the whole."""

    tallies: Mapping[tuple[str, str], Tally]
    """Tally by kind of finding and dimension; the dimension is empty where a finding is about whole steps."""
    ranges: Mapping[str, tuple[float, float]]
    """Lowest and highest value of each dimension of observation, action and exogenous inputs."""

    @staticmethod
    def of(transitions: Transitions, *, log: str, fences: Fences) -> Quality:
        """Judge the transitions of one log, at least one.

        Args:
            transitions: all that is in the log.
            log: its name.
            fences: where outliers begin, from `outlier_fences`.
        """
        places = _Places(log, transitions)
        tallies = {**_clock(transitions, places), **_episodes(transitions, places)}
        ranges = {}
        for column in _columns(transitions):
            name, values = column.name, column.values
            ranges[name] = (float(values.min()), float(values.max()))
            if column.dimension is not None:
                beyond_bounds = _beyond_bounds(column.dimension, values)
                below, above = fences[name]
                # What lies beyond a bound is told as that.
                outlying = ((values < below) | (values > above)) & ~beyond_bounds
                tallies["out_of_bounds", name] = places.tally(beyond_bounds, column.positions, values)
                tallies["outlier", name] = places.tally(outlying, column.positions, values)
        return Quality(tallies, ranges)

    def merge(self, other: Quality) -> Quality:
        """Add what was found in the logs after these, which have the same dimensions."""
        return Quality(
            {key: tally.merge(other.tallies[key]) for key, tally in self.tallies.items()},
            {
                name: (min(low, other.ranges[name][0]), max(high, other.ranges[name][1]))
                for name, (low, high) in self.ranges.items()
            },
        )


def outlier_sample(transitions: Transitions) -> Sample:
    """Sample what can have outliers: the dimensions of observation, continuous action and exogenous inputs."""
    columns = [transitions.observation]
    if isinstance(transitions.spec.action, ContinuousAction):
        columns.append(transitions.action)
    columns.append(transitions.exogenous)
    return Sample.of(np.concatenate(columns, axis=1))


def outlier_fences(spec: SpaceSpec, sample: Sample) -> Fences:
    """Return where outliers begin, from the quartiles of the sample that `outlier_sample` took.

    A dimension of which half of the values are equal, such as a contact, has no outliers.
    """
    names = [f"observation.{name}" for name in spec.observation_names]
    if isinstance(spec.action, ContinuousAction):
        names += [f"action.{dimension.name}" for dimension in spec.action.dimensions]
    names += [f"exogenous.{dimension.name}" for dimension in spec.exogenous]
    lower, median, upper = sample.quantiles(0.25, 0.5, 0.75)
    reach = np.where(upper > lower, OUTLIER_RANGES * (upper - lower), np.inf)
    return {
        name: (float(middle - away), float(middle + away))
        for name, middle, away in zip(names, median, reach, strict=True)
    }


@dataclass(frozen=True)
class _Column:
    """The values of one dimension."""

    name: str
    dimension: Dimension | None
    """What it means; None for the number of a discrete action."""
    values: Shaped[np.ndarray, " value"]
    positions: Float64[np.ndarray, " value"]
    """The row of each value; half a row later for the state after the last step of an episode."""


def _columns(transitions: Transitions) -> Iterator[_Column]:
    rows = np.arange(len(transitions), dtype=np.float64)
    ends = np.array([part.stop - 1 for part in transitions.episode_slices()])
    states = np.concatenate([transitions.observation, transitions.next_observation[ends]])
    positions = np.concatenate([rows, rows[ends] + 0.5])
    for dimension, values in zip(transitions.spec.observation, states.T, strict=True):
        yield _Column(f"observation.{dimension.name}", dimension, values, positions)
    action = transitions.spec.action
    if isinstance(action, ContinuousAction):
        for dimension, values in zip(action.dimensions, transitions.action.T, strict=True):
            yield _Column(f"action.{dimension.name}", dimension, values, rows)
    else:
        yield _Column("action", None, transitions.action, rows)
    for dimension, values in zip(transitions.spec.exogenous, transitions.exogenous.T, strict=True):
        yield _Column(f"exogenous.{dimension.name}", dimension, values, rows)


def _beyond_bounds(dimension: Dimension, values: Float32[np.ndarray, " value"]) -> Bool[np.ndarray, " value"]:
    # Bounds are rounded as the values are; one that float32 cannot hold becomes infinite and bounds nothing.
    with np.errstate(over="ignore"):
        low, high = np.float32(dimension.low), np.float32(dimension.high)
    beyond: Bool[np.ndarray, " value"] = (values < low) | (values > high)
    return beyond


@dataclass(frozen=True)
class _Places:
    """Turns rows of a log into places."""

    log: str
    transitions: Transitions

    def tally(
        self,
        found: Bool[np.ndarray, " value"],
        positions: Float[np.ndarray, " value"],
        values: Shaped[np.ndarray, " value"],
    ) -> Tally:
        """Count the values that were `found`, and place the first of them."""
        hits = np.flatnonzero(found)
        if not len(hits):
            return Tally(0, len(found), None)
        first = hits[positions[hits].argmin()]
        row = int(positions[first])
        step = int(self.transitions.step[row]) + int(positions[first] > row)
        place = Place(self.log, int(self.transitions.episode[row]), step, float(values[first]))
        return Tally(len(hits), len(found), place)


def _clock(transitions: Transitions, places: _Places) -> Tallies:
    """Judge the time between the steps of an episode."""
    rows = np.flatnonzero(transitions.episode[1:] == transitions.episode[:-1])
    seconds = np.diff(transitions.time_ns)[rows] / 1e9
    steps = seconds / transitions.spec.step_seconds
    backwards, gap = steps <= 0, steps > GAP
    jitter = ~backwards & ~gap & (abs(steps - 1) > JITTER)
    positions = (rows + 1).astype(np.float64)
    found = {"time_backwards": backwards, "gap": gap, "jitter": jitter}
    return {(kind, ""): places.tally(each, positions, seconds) for kind, each in found.items()}


def _episodes(transitions: Transitions, places: _Places) -> Tallies:
    """Judge whole episodes, by the dimensions of the state that do not move in them.

    An exogenous input, such as a setpoint, may well hold still in an episode; over a whole recording it should not.
    """
    slices = list(transitions.episode_slices())
    starts = np.array([rows.start for rows in slices])
    lengths = np.array([rows.stop - rows.start for rows in slices])
    positions = starts.astype(np.float64)
    tallies: Tallies = {}
    low = np.minimum.reduceat(np.minimum(transitions.observation, transitions.next_observation), starts)
    high = np.maximum.reduceat(np.maximum(transitions.observation, transitions.next_observation), starts)
    stuck = (low == high) & (lengths >= STUCK_STEPS)[:, None]
    for name, each, values in zip(transitions.spec.observation_names, stuck.T, low.T, strict=True):
        tallies["stuck_episode", f"observation.{name}"] = places.tally(each, positions, values)
    return tallies
