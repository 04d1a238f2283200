"""THE CONTRACT: what a log of an agent is (`Transitions`), and what its dimensions mean (`SpaceSpec`).

Every source of data ends in these types and everything after them begins there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int, Int32, Int64

from addressed_dynamics.base.errors import TransitionsError

NO_BOUND = 1e30
"""A bound as far out as this is none."""


CHECKED_ROWS = 2**18
"""Rows that are checked together."""

LEARNED = "addressed_dynamics/Learned-v0"
"""Gymnasium identifier of a model as an environment: transitions from there are predictions."""


@dataclass(frozen=True)
class Dimension:
    """One component of an observation, of a continuous action or of the exogenous inputs."""

    name: str
    """A protobuf-safe name, unique in its space: letters, digits and underscores, for instance `position`."""
    unit: str
    """The unit as text, for instance `rad/s`; empty if it has none."""
    low: float
    """Lowest possible value, in the unit above; minus infinity if unbounded, and in place of anything below -1e30."""
    high: float
    """Highest possible value, in the unit above; infinity if unbounded, and in place of anything above 1e30."""

    def __post_init__(self) -> None:
        # Environments give the greatest number of their data type where they know no bound.
        if self.low <= -NO_BOUND:
            object.__setattr__(self, "low", -math.inf)
        if self.high >= NO_BOUND:
            object.__setattr__(self, "high", math.inf)


@dataclass(frozen=True)
class DiscreteAction:
    """A finite set of actions, numbered from 0."""

    names: tuple[str, ...]
    """One name for each action, for instance `push_left`."""

    @property
    def count(self) -> int:
        """Number of actions."""
        return len(self.names)


@dataclass(frozen=True)
class ContinuousAction:
    """A vector of real numbers."""

    dimensions: tuple[Dimension, ...]
    """What each component means."""


@dataclass(frozen=True)
class SpaceSpec:
    """What the numbers in a log mean: the names, units and bounds of what is in a step, and the clock."""

    observation: tuple[Dimension, ...]
    """The dimensions of an observation, in order."""
    action: DiscreteAction | ContinuousAction
    """The kind of action and what it consists of."""
    step_seconds: float
    """Simulated time between two steps, in seconds."""
    exogenous: tuple[Dimension, ...] = ()
    """The dimensions of the exogenous inputs, in order: what acts on the world and is known, not predicted, for
    instance a wind, a slope or a setpoint. None in most worlds."""

    @property
    def observation_names(self) -> tuple[str, ...]:
        """Names of the observation's dimensions, in order."""
        return tuple(dimension.name for dimension in self.observation)

    def to_json(self) -> dict[str, Any]:
        """Return the spec as JSON-compatible values; infinite bounds become null."""
        action: dict[str, Any]
        if isinstance(self.action, DiscreteAction):
            action = {"kind": "discrete", "names": list(self.action.names)}
        else:
            action = {"kind": "continuous", "dimensions": [_dimension_to_json(d) for d in self.action.dimensions]}
        exogenous = [_dimension_to_json(dimension) for dimension in self.exogenous]
        return {
            "observation": [_dimension_to_json(dimension) for dimension in self.observation],
            "action": action,
            "step_seconds": self.step_seconds,
            # Absent where there are none, so that such a spec is written as it was before there could be any.
            **({"exogenous": exogenous} if exogenous else {}),
        }

    @staticmethod
    def from_json(value: Any) -> SpaceSpec:
        """Read what `to_json` wrote.

        Raises:
            TransitionsError: `value` does not have that form.
        """
        try:
            action = value["action"]
            return SpaceSpec(
                observation=tuple(_dimension_from_json(dimension) for dimension in value["observation"]),
                action=(
                    DiscreteAction(tuple(str(name) for name in action["names"]))
                    if action["kind"] == "discrete"
                    else ContinuousAction(tuple(_dimension_from_json(d) for d in action["dimensions"]))
                ),
                step_seconds=float(value["step_seconds"]),
                exogenous=tuple(_dimension_from_json(dimension) for dimension in value.get("exogenous", ())),
            )
        except (KeyError, TypeError, ValueError) as error:
            message = f"a description of spaces is incomplete or malformed ({type(error).__name__}: {error})"
            raise TransitionsError(message) from error


@dataclass(frozen=True)
class Transitions:
    """Logged transitions in episode order; row t is one step of an environment. Validated on construction."""

    spec: SpaceSpec
    """Names, units and bounds of everything below."""
    episode: Int64[np.ndarray, " step"]
    """Identifier of the episode, unique in a recording; the rows of an episode are contiguous."""
    step: Int32[np.ndarray, " step"]
    """Number of the step in its episode, from 0 (later if the log begins inside an episode), without gaps."""
    time_ns: Int64[np.ndarray, " step"]
    """Simulated time of the step, in nanoseconds."""
    observation: Float32[np.ndarray, "step observation"]
    """State before the action, in the environment's own units."""
    action: Int64[np.ndarray, " step"] | Float32[np.ndarray, "step action"]
    """The action taken: its number if discrete, else a vector in the environment's own units."""
    reward: Float32[np.ndarray, " step"]
    """The environment's reward for the step."""
    next_observation: Float32[np.ndarray, "step observation"]
    """State after the action, in the environment's own units; row t equals observation[t + 1] inside an episode."""
    terminated: Bool[np.ndarray, " step"]
    """The step ended the episode for a reason inside the task, such as reaching the goal."""
    truncated: Bool[np.ndarray, " step"]
    """The step ended the episode for a reason outside the task, such as a time limit or the end of the recording."""
    exogenous: Float32[np.ndarray, "step exogenous"] = field(default_factory=lambda: np.empty((0, 0), np.float32))
    """The exogenous inputs during the step, in their own units: they stand beside the action. They need not be given
    if the spaces have none, and are then of no width."""

    def __post_init__(self) -> None:
        if not self.spec.exogenous and self.exogenous.shape == (0, 0):
            object.__setattr__(self, "exogenous", np.empty((len(self.episode), 0), np.float32))
        _check_columns(self)
        _check_episodes(self)

    def __len__(self) -> int:
        return len(self.episode)

    def select(self, rows: slice | Bool[np.ndarray, " step"] | Int[np.ndarray, " row"]) -> Transitions:
        """Return the transitions at `rows`, which must keep whole stretches of episodes together.

        Raises:
            TransitionsError: the rows left in an episode are not consecutive steps.
        """
        columns = {name: getattr(self, name)[rows] for name in COLUMNS}
        return Transitions(spec=self.spec, **columns)

    def episode_slices(self) -> Iterator[slice]:
        """Yield the rows of each episode, in order."""
        inner = np.flatnonzero(self.episode[1:] != self.episode[:-1]) + 1
        starts = np.concatenate([[0], inner]) if len(self) else inner
        stops = np.concatenate([inner, [len(self)]]) if len(self) else inner
        for start, stop in zip(starts, stops, strict=True):
            yield slice(int(start), int(stop))

    @staticmethod
    def from_arrays(observations: Any, actions: Any, **options: Any) -> Transitions:
        """Make transitions of NumPy arrays, or of pandas or Polars data frames, with a row per step.

        K rows of an episode are K - 1 transitions, unless `next_observations` are given: the last row is only the state
        after the step before it, and its action and reward are not used.

        Args:
            observations: an array (row, dimension), or a data frame whose columns name the dimensions.
            actions: the same; one column of integers, or of texts, is a discrete action.
            **options: `rate_hz`, steps in a second, is needed. `episodes`, an identifier for each row, or `lengths`,
                the rows of each episode: without both, an episode ends where `terminated` or `truncated`, which stand
                in its last row, are true. `rewards`, `next_observations` and `exogenous` by row.
                `observation_names`, `action_names` and `exogenous_names`, in place of those of columns. `discrete`,
                if the actions do not show it.

        Raises:
            TransitionsError: the arrays do not make transitions; the message says which row or value is why.
        """
        from addressed_dynamics.episodes.arrays import transitions_from_arrays

        return transitions_from_arrays(observations, actions, **options)

    @staticmethod
    def concatenate(parts: Sequence[Transitions]) -> Transitions:
        """Join transitions of the same spaces, in the given order.

        Raises:
            TransitionsError: there are no parts, their spaces differ, or an episode occurs in two of them (unless the
                second part begins with the step that follows the end of the first).
        """
        if not parts:
            message = "there are no transitions to join: the list of parts is empty"
            raise TransitionsError(message)
        spec = parts[0].spec
        if any(part.spec != spec for part in parts):
            message = "the parts come from environments with different spaces; keep one environment per experiment"
            raise TransitionsError(message)
        columns = {name: np.concatenate([getattr(part, name) for part in parts]) for name in COLUMNS}
        return Transitions(spec=spec, **columns)


COLUMNS = tuple(field.name for field in fields(Transitions) if field.name != "spec")
"""Names of the columns of `Transitions`, in order."""


def _check_columns(transitions: Transitions) -> None:
    length, width = len(transitions.episode), len(transitions.spec.observation)
    action_spec = transitions.spec.action
    expected: dict[str, tuple[type, tuple[int, ...]]] = {
        "episode": (np.int64, (length,)),
        "step": (np.int32, (length,)),
        "time_ns": (np.int64, (length,)),
        "observation": (np.float32, (length, width)),
        "action": (
            (np.int64, (length,))
            if isinstance(action_spec, DiscreteAction)
            else (np.float32, (length, len(action_spec.dimensions)))
        ),
        "reward": (np.float32, (length,)),
        "next_observation": (np.float32, (length, width)),
        "terminated": (np.bool_, (length,)),
        "truncated": (np.bool_, (length,)),
        "exogenous": (np.float32, (length, len(transitions.spec.exogenous))),
    }
    for name, (dtype, shape) in expected.items():
        column = getattr(transitions, name)
        if column.dtype != dtype or column.shape != shape:
            message = (
                f"column '{name}' should be {np.dtype(dtype).name} of shape {shape}, "
                f"but is {column.dtype.name} of shape {column.shape}"
            )
            raise TransitionsError(message)
        for rows in _blocks(length) if column.dtype == np.float32 else ():
            if not np.isfinite(column[rows]).all():
                row = rows.start + int(
                    np.flatnonzero(~np.isfinite(column[rows]).reshape(len(column[rows]), -1).all(axis=1))[0]
                )
                message = f"column '{name}' has a value that is not finite in row {row}: {column[row].tolist()}"
                raise TransitionsError(message)
    if isinstance(action_spec, DiscreteAction) and length:
        lowest, highest = int(transitions.action.min()), int(transitions.action.max())
        if lowest < 0 or highest >= action_spec.count:
            message = f"actions should lie in 0..{action_spec.count - 1}, but lie in {lowest}..{highest}"
            raise TransitionsError(message)


def _check_episodes(transitions: Transitions) -> None:
    if not len(transitions):
        return
    starts = [transitions.episode[:1]]
    for rows in _blocks(len(transitions)):
        # With the row before them, which the first of them follows.
        first = max(rows.start - 1, 0)
        block = {name: getattr(transitions, name)[first : rows.stop] for name in COLUMNS}
        episode = block["episode"]
        same = episode[1:] == episode[:-1]
        jump = same & (block["next_observation"][:-1] != block["observation"][1:]).any(axis=1)
        ends = block["terminated"] | block["truncated"]
        for broken, what in (
            (same & (np.diff(block["step"]) != 1), "is not followed by the next step of its episode"),
            (jump, "has a next_observation that is not the observation of the step after it"),
            (same & ends[:-1], "ends its episode, but more steps of the episode follow"),
        ):
            if broken.any():
                row = first + int(np.flatnonzero(broken)[0])
                message = f"row {row} (episode {transitions.episode[row]}, step {transitions.step[row]}) {what}"
                raise TransitionsError(message)
        starts.append(episode[1:][~same])
    values, counts = np.unique(np.concatenate(starts), return_counts=True)
    if (counts > 1).any():
        message = f"the rows of episode {values[counts > 1][0]} are not contiguous, or two recordings share the number"
        raise TransitionsError(message)


def _blocks(count: int) -> Iterator[slice]:
    for first in range(0, count, CHECKED_ROWS):
        yield slice(first, min(first + CHECKED_ROWS, count))


def _dimension_to_json(dimension: Dimension) -> dict[str, Any]:
    return {
        "name": dimension.name,
        "unit": dimension.unit,
        "low": float(dimension.low) if np.isfinite(dimension.low) else None,
        "high": float(dimension.high) if np.isfinite(dimension.high) else None,
    }


def _dimension_from_json(value: Any) -> Dimension:
    low, high = value["low"], value["high"]
    return Dimension(
        name=str(value["name"]),
        unit=str(value["unit"]),
        low=-np.inf if low is None else float(low),
        high=np.inf if high is None else float(high),
    )
