"""What imported samples are good for: a verdict on each episode, what the actions move and when, and what is noise."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float64

from addressed_dynamics.episodes.noise import find_noise
from addressed_dynamics.importing.samples import Episodes, Samples
from addressed_dynamics.importing.signals import Signals

STILL = 0.5
"""Share of the steps of an episode in which no state changes, from which on one has to look."""
FAR = 10.0
"""Interquartile ranges from the median beyond which a value is far from all others."""
LONGEST_DELAY_S = 1.0
"""The longest delay between an action and a state that is looked for."""
LAGS = 50
"""The most steps that such a delay may have."""
MOST_POINTS = 3_000
"""So many samples at most are compared with each other for the noise."""
EFFECT = 0.01
"""Share of what the state does not explain by itself that an action has to explain to count as its cause."""

Verdict = Literal["use", "look", "leave"]


@dataclass(frozen=True)
class EpisodeJudgement:
    """Whether to train on an episode."""

    file: str
    """The first file of its recording."""
    number: int
    """Its number in the recording, from 0; those that are too short are counted too."""
    start_s: float
    """When it begins, in seconds after the first sample of the recording."""
    seconds: float
    """How long it lasts."""
    samples: int
    verdict: Verdict
    """`leave`: nothing to learn from; `look`: something is unusual."""
    reasons: tuple[str, ...]
    """Why it is not simply to be used, with times in seconds after the start of the episode."""


@dataclass(frozen=True)
class Excitation:
    """How much an action dimension was moved."""

    name: str
    low: float
    high: float
    changing: float
    """Share of the steps in which it changes."""
    values: int
    """Number of different values, at most 1,000."""
    covered: float
    """Share of tenths of its range that hold values; 0 if it never changes."""


@dataclass(frozen=True)
class Delay:
    """When an action shows in a state."""

    action: str
    state: str
    """The state whose change it explains best."""
    steps: int
    """Steps between the action and the change that it explains."""
    seconds: float
    explained: float
    """Share of the change that neither the state nor a constant explains and this action does, by least squares."""


@dataclass(frozen=True)
class Noise:
    """What cannot be predicted of a state, by the gamma test."""

    name: str
    deviation: float
    """Standard deviation of what differs between steps that begin alike, in the state's unit."""
    share: float
    """The same as a share of the standard deviation of the state's change in a step."""


@dataclass(frozen=True)
class Judgement:
    """What some recordings are good for."""

    episodes: tuple[EpisodeJudgement, ...]
    excitations: tuple[Excitation, ...]
    delays: tuple[Delay, ...]
    noises: tuple[Noise, ...]


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples of an episode."""

    states: Float64[np.ndarray, "sample state"]
    inputs: Float64[np.ndarray, "sample input"]
    """Actions."""
    exogenous: Float64[np.ndarray, "sample exogenous"]
    """What else is known."""


def judge_episodes(
    file: str, samples: Samples, episodes: Episodes, signals: Signals, *, min_length: int, step_seconds: float
) -> list[EpisodeJudgement]:
    """Judge every episode of a recording, those that are too short included.

    Args:
        file: the first file of the recording.
        samples: all of its samples.
        episodes: those that are long enough; the others are found anew.
        signals: what the samples consist of.
        min_length: samples that an episode needs.
        step_seconds: time between two samples.
    """
    if not len(samples.follows):
        return []
    kept = {each.start for each in episodes.slices}
    starts = np.flatnonzero(~samples.follows)
    fences = _fences(samples.values[:, signals.observation_columns])
    judged = []
    for number, (start, stop) in enumerate(zip(starts, [*starts[1:], len(samples.follows)], strict=True)):
        states = samples.values[start:stop, signals.observation_columns]
        actions = samples.values[start : stop - 1, signals.action_columns]
        leave = [] if start in kept else [f"{stop - start} samples are fewer than min_length ({min_length})"]
        if not leave and (states == states[0]).all():
            leave = ["no state ever changes"]
        look = [] if leave else list(_unusual(states, actions, fences, signals, step_seconds))
        judged.append(
            EpisodeJudgement(
                file=file,
                number=number,
                start_s=_since_start(samples, int(start), step_seconds),
                seconds=float(stop - start - 1) * step_seconds,
                samples=int(stop - start),
                verdict="leave" if leave else "look" if look else "use",
                reasons=tuple(leave or look),
            )
        )
    return judged


def stretches(samples: Samples, episodes: Episodes, signals: Signals) -> list[Stretch]:
    """Return the states and actions of each episode."""
    return [
        Stretch(
            samples.values[rows, signals.observation_columns],
            samples.values[rows, signals.action_columns],
            samples.values[rows, signals.exogenous_columns],
        )
        for rows in episodes.slices
    ]


def judge_all(stretches: Sequence[Stretch], signals: Signals) -> tuple[list[Excitation], list[Delay], list[Noise]]:
    """Judge what the actions do, and how much is noise, over all episodes.

    Args:
        stretches: at least one.
        signals: what the samples consist of.
    """
    states = [dimension.name for dimension in signals.spec.observation]
    actions = _action_names(signals)
    excitations = [_excitation(name, stretches, column) for column, name in enumerate(actions)]
    step_seconds = signals.spec.step_seconds
    delays = [found for column, name in enumerate(actions)
              if (found := _delay(name, column, states, stretches, step_seconds)) is not None]  # fmt: skip
    return excitations, delays, _noises(states, stretches)


def _since_start(samples: Samples, row: int, step_seconds: float) -> float:
    if samples.time_ns is None:
        return row * step_seconds
    return float(samples.time_ns[row] - samples.time_ns[0]) / 1e9


def _fences(states: Float64[np.ndarray, "sample state"]) -> tuple[np.ndarray, np.ndarray]:
    lower, middle, upper = np.quantile(states, [0.25, 0.5, 0.75], axis=0)
    # A dimension of which half of the values are equal, such as a contact, has none that are far off.
    reach = np.where(upper > lower, FAR * (upper - lower), np.inf)
    return middle - reach, middle + reach


def _unusual(
    states: Float64[np.ndarray, "sample state"],
    actions: Float64[np.ndarray, "step input"],
    fences: tuple[np.ndarray, np.ndarray],
    signals: Signals,
    step_seconds: float,
) -> Iterator[str]:
    names = [dimension.name for dimension in signals.spec.observation]
    for name, column in zip(names, states.T, strict=True):
        if (column == column[0]).all():
            yield f"{name} never changes"
    for name, column in zip(_action_names(signals), actions.T, strict=True):
        if (column == column[0]).all():
            yield f"the action {name} never changes"
    still = (states[1:] == states[:-1]).all(axis=1)
    if still.mean() > STILL:
        yield f"no state changes in {still.mean():.0%} of its steps, first at {_first(still) * step_seconds:.2f} s"
    outside = (states < fences[0]) | (states > fences[1])
    for name, column in zip(names, outside.T, strict=True):
        if column.any():
            first = f"first at {_first(column) * step_seconds:.2f} s"
            yield f"{name} is far from all its other values {column.sum()} times, {first}"


def _first(found: Bool[np.ndarray, " row"]) -> int:
    return int(found.argmax())


def _action_names(signals: Signals) -> list[str]:
    action = signals.spec.action
    return [each.name for each in getattr(action, "dimensions", ())] or ["action"]


def _excitation(name: str, stretches: Sequence[Stretch], column: int) -> Excitation:
    values = np.concatenate([each.inputs[:, column] for each in stretches])
    changes = np.concatenate([np.diff(each.inputs[:, column]) != 0 for each in stretches])
    low, high = float(values.min()), float(values.max())
    tenths = np.minimum((values - low) / (high - low) * 10, 9).astype(int) if high > low else np.zeros(0, dtype=int)
    return Excitation(
        name=name,
        low=low,
        high=high,
        changing=float(changes.mean()) if len(changes) else 0.0,
        values=min(len(np.unique(values)), 1_000),
        covered=len(np.unique(tenths)) / 10,
    )


def _delay(
    action: str, column: int, states: Sequence[str], stretches: Sequence[Stretch], step_seconds: float
) -> Delay | None:
    """Find the lag at which an action explains most of the change that the state itself does not."""
    lags = min(LAGS, round(LONGEST_DELAY_S / step_seconds) + 1, min(len(each.states) for each in stretches) // 3)
    if lags < 1 or not any(np.ptp(each.inputs[:, column]) > 0 for each in stretches):
        return None
    # Every lag is judged on the same steps: those before which so many are known.
    before = np.concatenate([np.column_stack([each.states, each.exogenous])[lags:-1] for each in stretches])
    change = np.concatenate([np.diff(each.states[lags:], axis=0) for each in stretches])
    known = np.column_stack([before, np.ones(len(before))])
    rest = _residual(known, change)
    moving = (change.std(axis=0) > 0) & ((rest**2).sum(axis=0) > 1e-12 * (change**2).sum(axis=0))
    explained = np.zeros((lags + 1, len(states)))
    for behind in range(lags + 1):
        acting = np.concatenate(
            [each.inputs[lags - behind : len(each.inputs) - 1 - behind, column] for each in stretches]
        )
        unexplained = _residual(known, acting[:, None])
        size = float((unexplained**2).sum())
        if size > 0:
            share = (unexplained * rest).sum(axis=0) ** 2 / size / np.maximum((rest**2).sum(axis=0), 1e-300)
            explained[behind] = np.where(moving, share, 0.0)
    lag, state = np.unravel_index(explained.argmax(), explained.shape)
    best = float(explained[lag, state])
    if best < EFFECT:
        return None
    return Delay(action, states[int(state)], int(lag), int(lag) * step_seconds, best)


def _residual(
    known: Float64[np.ndarray, "row known"], wanted: Float64[np.ndarray, "row wanted"]
) -> Float64[np.ndarray, "row wanted"]:
    """Return what least squares do not explain of the columns of `wanted`."""
    residual: Float64[np.ndarray, "row wanted"] = wanted - known @ np.linalg.lstsq(known, wanted, rcond=None)[0]
    return residual


def _noises(states: Sequence[str], stretches: Sequence[Stretch]) -> list[Noise]:
    """Estimate the noise of each state: what differs between steps that begin alike, as their distance goes to zero."""
    every = [np.column_stack([each.states, each.inputs, each.exogenous]) for each in stretches]
    inputs = np.concatenate([each[:-1] for each in every])
    change = np.concatenate([np.diff(each.states, axis=0) for each in stretches])
    rows = np.unique(np.linspace(0, len(inputs) - 1, MOST_POINTS).astype(int))
    inputs, change = inputs[rows], change[rows]
    moving = inputs.std(axis=0) > 0
    scaled = inputs[:, moving] / inputs[:, moving].std(axis=0)
    found = find_noise(scaled, change)
    if found is None:
        return []
    return [
        Noise(name, variance**0.5, variance**0.5 / spread if spread > 0 else 0.0)
        for name, variance, spread in zip(states, found.variance.tolist(), change.std(axis=0).tolist(), strict=True)
    ]
