"""Transitions from arrays or data frames that are in memory."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int64
from numpy.typing import ArrayLike

from addressed_dynamics.base.errors import TransitionsError
from addressed_dynamics.episodes.precision import swallowed
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec, Transitions

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def transitions_from_arrays(
    observations: Any,
    actions: Any,
    *,
    rate_hz: float,
    episodes: ArrayLike | None = None,
    lengths: ArrayLike | None = None,
    rewards: ArrayLike | None = None,
    next_observations: Any = None,
    exogenous: Any = None,
    terminated: ArrayLike | None = None,
    truncated: ArrayLike | None = None,
    observation_names: Sequence[str] | None = None,
    action_names: Sequence[str] | None = None,
    exogenous_names: Sequence[str] | None = None,
    discrete: bool | None = None,
) -> Transitions:
    """Make transitions of arrays with a row per step, as `Transitions.from_arrays` describes.

    Raises:
        TransitionsError: the arrays do not make transitions; the message says which row or value is why.
    """
    state, names = _matrix("observations", observations)
    count = len(state)
    if not count:
        message = "observations should have a row per step, but there are none"
        raise TransitionsError(message)
    if not np.isfinite(rate_hz) or rate_hz <= 0:
        message = f"rate_hz should be the number of steps in a second, but is {rate_hz}"
        raise TransitionsError(message)
    space, action = _action(actions, count, action_names, discrete)
    dimensions = _dimensions("observation", observation_names or names, state.shape[1])
    inputs, input_names = (np.zeros((count, 0)), []) if exogenous is None else _matrix("exogenous", exogenous, count)
    known = _dimensions("exogenous", exogenous_names or input_names, inputs.shape[1])
    ends = [_flags(name, each, count) for name, each in (("terminated", terminated), ("truncated", truncated))]
    labels = _labels(count, episodes, lengths, ends[0] | ends[1])
    last = np.append(labels[1:] != labels[:-1], True)
    _check_ends(ends[0] | ends[1], last)
    reward = np.zeros((count, 1)) if rewards is None else _matrix("rewards", rewards, count)[0]
    _check_precision(dimensions, state, np.append(False, ~last[:-1]))
    if next_observations is None:
        # The last row of an episode is only the state after the step before it.
        rows = np.flatnonzero(~last)
        after, place = state[rows + 1], rows + 1
    else:
        rows = place = np.arange(count)
        after, _ = _matrix("next_observations", next_observations, count)
    first = np.append(True, labels[rows][1:] != labels[rows][:-1])[: len(rows)]
    step = np.arange(len(rows)) - np.maximum.accumulate(np.where(first, np.arange(len(rows)), 0))
    return Transitions(
        spec=SpaceSpec(dimensions, space, 1.0 / rate_hz, exogenous=known),
        episode=labels[rows],
        step=step.astype(np.int32),
        time_ns=np.rint(np.arange(len(rows)) * (1e9 / rate_hz)).astype(np.int64),
        observation=_single(state[rows]),
        action=action[rows],
        reward=_single(reward[rows, 0]),
        next_observation=_single(after),
        terminated=ends[0][place],
        truncated=last[place] & ~ends[0][place],
        exogenous=_single(inputs[rows]),
    )


def _matrix(name: str, values: Any, count: int | None = None) -> tuple[Float64[np.ndarray, "row column"], list[str]]:
    """Return numbers with a row per step, and the names of the columns if there are any."""
    columns = list(getattr(values, "columns", ()))
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        message = f"{name} should be numbers with a row per step, but {str(error).splitlines()[0]}"
        raise TransitionsError(message) from error
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2:
        message = f"{name} should have a row per step and a column per dimension, but has the shape {array.shape}"
        raise TransitionsError(message)
    if count is not None and len(array) != count:
        message = f"{name} should have {count} rows, as many as observations, but has {len(array)}"
        raise TransitionsError(message)
    # Data frames without names number their columns.
    return array, [] if all(isinstance(each, int | np.integer) for each in columns) else [str(each) for each in columns]


def _action(
    actions: Any, count: int, names: Sequence[str] | None, discrete: bool | None
) -> tuple[DiscreteAction | ContinuousAction, Int64[np.ndarray, " row"] | Float32[np.ndarray, "row action"]]:
    array = np.asarray(actions)
    texts = array.ndim == 1 and array.dtype.kind in "UOST" and all(isinstance(each, str) for each in array)
    if not (texts or (array.ndim == 1 and array.dtype.kind in "iu" if discrete is None else discrete)):
        numbers, columns = _matrix("actions", actions, count)
        return ContinuousAction(_dimensions("action", names or columns, numbers.shape[1])), _single(numbers)
    if len(array) != count or array.ndim != 1:
        message = f"actions should be {count} numbers, one for each observation, but have the shape {array.shape}"
        raise TransitionsError(message)
    if texts:
        unknown = sorted(set(array.tolist()) - set(names or ()))
        if unknown:
            message = f"actions are texts, such as '{unknown[0]}', that are not in action_names; name all in order"
            raise TransitionsError(message)
        array = np.array([list(names or ()).index(each) for each in array])
    numbers, _ = _matrix("actions", array, count)
    whole = numbers[:, 0].astype(np.int64) if np.isfinite(numbers).all() else np.zeros(count, dtype=np.int64)
    if (whole != numbers[:, 0]).any():
        row = int(np.flatnonzero(whole != numbers[:, 0])[0])
        message = f"actions should be whole numbers, but row {row} has {numbers[row, 0]}; give discrete=False"
        raise TransitionsError(message)
    return DiscreteAction(tuple(names or (f"action_{number}" for number in range(int(whole.max()) + 1)))), whole


def _dimensions(kind: str, names: Sequence[str], width: int) -> tuple[Dimension, ...]:
    names = list(names) or [f"{kind}_{place}" for place in range(width)]
    bad = [name for name in names if not _NAME.fullmatch(name)]
    if bad or len(names) != width or len(set(names)) < width:
        message = (
            f"the {width} dimensions of {kind} need as many different names of letters, digits and underscores, but "
            f"they are {', '.join(names)}; give {kind}_names"
        )
        raise TransitionsError(message)
    return tuple(Dimension(name, "", -np.inf, np.inf) for name in names)


def _flags(name: str, values: ArrayLike | None, count: int) -> Bool[np.ndarray, " row"]:
    if values is None:
        return np.zeros(count, dtype=np.bool_)
    flags, _ = _matrix(name, values, count)
    if flags.shape[1] != 1 or not np.isin(flags, (0.0, 1.0)).all():
        message = f"{name} should be true or false in each row; there are other values"
        raise TransitionsError(message)
    return np.asarray(flags[:, 0] == 1.0)


def _labels(
    count: int, episodes: ArrayLike | None, lengths: ArrayLike | None, ends: Bool[np.ndarray, " row"]
) -> Int64[np.ndarray, " row"]:
    """Return the number of the episode of each row."""
    if episodes is not None and lengths is not None:
        message = "episodes and lengths both say what an episode is; give one of them"
        raise TransitionsError(message)
    if lengths is not None:
        rows = np.asarray(lengths)
        if rows.ndim != 1 or rows.dtype.kind not in "iu" or (rows < 1).any() or rows.sum() != count:
            message = f"lengths should be the rows of each episode, {count} together, but are {rows.tolist()!r:.80}"
            raise TransitionsError(message)
        return np.repeat(np.arange(len(rows), dtype=np.int64), rows)
    if episodes is None:
        return np.append(0, np.cumsum(ends[:-1])).astype(np.int64)
    ids = np.asarray(episodes)
    if ids.shape != (count,):
        message = f"episodes should be {count} identifiers, one for each row, but have the shape {ids.shape}"
        raise TransitionsError(message)
    starts = np.append(True, ids[1:] != ids[:-1])
    first = ids[starts].tolist()
    again = next((each for place, each in enumerate(first) if each in set(first[:place])), None)
    if again is not None:
        message = f"episode {again!r} comes back after another one; number episodes over all runs"
        raise TransitionsError(message)
    return ids.astype(np.int64) if ids.dtype.kind in "iu" else np.cumsum(starts).astype(np.int64) - 1


def _check_ends(ends: Bool[np.ndarray, " row"], last: Bool[np.ndarray, " row"]) -> None:
    inside = np.flatnonzero(ends & ~last)
    if len(inside):
        message = f"row {inside[0]} is terminated or truncated, but the episode goes on; number what follows anew"
        raise TransitionsError(message)


def _check_precision(
    dimensions: tuple[Dimension, ...], values: Float64[np.ndarray, "row column"], follows: Bool[np.ndarray, " row"]
) -> None:
    found = swallowed(values, follows)
    for place in np.flatnonzero(found.mostly):
        message = (
            f"observations: float32 cannot hold '{dimensions[place].name}': {found.lost[place]} of "
            f"{found.changed[place]} steps that change it are lost; take an offset off it, such as its mean"
        )
        raise TransitionsError(message)


def _single(values: Float64[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    with np.errstate(over="ignore"):  # what does not fit becomes infinite, and is refused as that
        return values.astype(np.float32)
