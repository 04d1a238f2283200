"""What an import takes from a source: one signal per number of a transition, and the spaces that they make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.source import (
    DiscreteParams,
    EpisodeByColumn,
    EpisodeByTopic,
    FieldParams,
    LerobotSource,
    McapSource,
    SourceParams,
    TableSource,
)
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.importing.paths import expand_slice

LEROBOT_EPISODE = "episode_index"
"""Column of a LeRobot dataset with the number of the episode."""


@dataclass(frozen=True)
class Signal:
    """One number of a sample."""

    field: str
    """Its path or column."""
    number: Callable[[Any], float]
    """Makes a number of what is there: NaN if nothing is. Raises TypeError, ValueError or KeyError on what is none."""
    names: tuple[str, ...] = ()
    """Texts that are values and no numbers, whatever they look like."""
    takes_text: bool = False
    """Any text is a value."""
    offset: float = 0.0
    """What is taken off the number before it becomes a float32."""

    @property
    def plain(self) -> bool:
        """Numbers are taken as they are."""
        return self.number is _number


@dataclass(frozen=True)
class Signals:
    """All numbers of a sample, in order: observation, action, exogenous inputs, reward, label and ends.

    All but the first two may be absent.
    """

    spec: SpaceSpec
    """The spaces of the transitions."""
    observation: tuple[Signal, ...]
    action: tuple[Signal, ...]
    """One per component, or the one with the number of a discrete action."""
    reward: Signal | None
    label: Signal | None
    """Changes its value from episode to episode."""
    exogenous: tuple[Signal, ...] = ()
    terminated: Signal | None = None
    """Not 0 in the last sample of an episode that ends for a reason inside the task."""
    truncated: Signal | None = None
    """Not 0 in the last sample of an episode that ends for another reason."""

    @property
    def all(self) -> tuple[Signal, ...]:
        """All signals; their order is that of the columns of `Samples.values`."""
        rest = (self.reward, self.label, self.terminated, self.truncated)
        present = (signal for signal in rest if signal is not None)
        return (*self.observation, *self.action, *self.exogenous, *present)

    @property
    def observation_columns(self) -> slice:
        """Columns of the observation."""
        return slice(0, len(self.observation))

    @property
    def action_columns(self) -> slice:
        """Columns of the action."""
        return slice(len(self.observation), len(self.observation) + len(self.action))

    @property
    def exogenous_columns(self) -> slice:
        """Columns of the exogenous inputs."""
        return slice(self.action_columns.stop, self.action_columns.stop + len(self.exogenous))

    @property
    def reward_column(self) -> int | None:
        """Column of the reward, if there is one."""
        return self._column(self.reward, ())

    @property
    def label_column(self) -> int | None:
        """Column of the label, if there is one."""
        return self._column(self.label, (self.reward,))

    @property
    def terminated_column(self) -> int | None:
        """Column that says where an episode ends inside the task, if there is one."""
        return self._column(self.terminated, (self.reward, self.label))

    @property
    def truncated_column(self) -> int | None:
        """Column that says where an episode ends otherwise, if there is one."""
        return self._column(self.truncated, (self.reward, self.label, self.terminated))

    @property
    def offsets(self) -> Float64[np.ndarray, " signal"]:
        """What is taken off each signal."""
        return np.array([signal.offset for signal in self.all])

    def _column(self, signal: Signal | None, before: tuple[Signal | None, ...]) -> int | None:
        if signal is None:
            return None
        vectors = len(self.observation) + len(self.action) + len(self.exogenous)
        return vectors + sum(each is not None for each in before)


EXACT = 2**53
"""From here on float64 lacks whole numbers."""


class _Labels(dict[Any, int]):
    """Numbers labels in the order in which they come."""

    def __missing__(self, label: Any) -> int:
        self[label] = len(self)
        return self[label]


def plain_signal(field: str) -> Signal:
    """Return a signal that takes numbers as they are."""
    return Signal(field, _number)


def rate_of(source: SourceParams) -> float:
    """Return the rate that `source` names, in steps a second.

    Raises:
        ParamsError: it names none.
    """
    if source.rate_hz is None:
        message = "nothing says how many steps there are in a second; give the source a rate_hz"
        raise ParamsError(message)
    return source.rate_hz


def signals_of(source: SourceParams, rate_hz: float | None = None) -> Signals:
    """Return what `source` asks for.

    Args:
        source: the section of the params.
        rate_hz: steps in a second; may be left out if `source` says it.

    Raises:
        ParamsError: nothing says the rate, a slice is malformed, two dimensions come to have the same name, bounds are
            the wrong way round, or two actions have the same name.
    """
    rate_hz = rate_of(source) if rate_hz is None else rate_hz
    dimensions, observation = _expanded(source.observation)
    space: ContinuousAction | DiscreteAction
    action: tuple[Signal, ...]
    if source.action.discrete is not None:
        space = DiscreteAction(source.action.discrete.names)
        action = (_discrete(source.action.discrete),)
    else:
        components, action = _expanded(source.action.continuous or {})
        space = ContinuousAction(components)
    inputs, exogenous = _expanded(source.exogenous)
    return Signals(
        spec=SpaceSpec(dimensions, space, step_seconds=1.0 / rate_hz, exogenous=inputs),
        observation=observation,
        action=action,
        reward=None if source.reward is None else plain_signal(source.reward),
        label=_label(source),
        exogenous=exogenous,
        terminated=None if source.terminated is None else plain_signal(source.terminated),
        truncated=None if source.truncated is None else plain_signal(source.truncated),
    )


def _expanded(fields: Mapping[str, FieldParams]) -> tuple[tuple[Dimension, ...], tuple[Signal, ...]]:
    dimensions, signals = [], []
    for name, params in fields.items():
        low = -np.inf if params.low is None else params.low - params.offset
        high = np.inf if params.high is None else params.high - params.offset
        if low > high:
            message = f"'{name}' has the bounds {params.low} and {params.high}, but low should not be above high"
            raise ParamsError(message)
        for place, field in expand_slice(params.field):
            full_name = name if place is None else f"{name}_{place}"
            dimensions.append(Dimension(full_name, params.unit, low, high))
            signals.append(Signal(field, _number, offset=params.offset))
    names = [dimension.name for dimension in dimensions]
    if len(set(names)) < len(names):
        message = f"two dimensions come to have the same name ({', '.join(names)}); rename one"
        raise ParamsError(message)
    return tuple(dimensions), tuple(signals)


def _label(source: SourceParams) -> Signal | None:
    match source:
        case McapSource(episode=EpisodeByTopic(field=field)) | TableSource(episode=EpisodeByColumn(column=field)):
            pass
        case LerobotSource():
            field = LEROBOT_EPISODE
        case _:
            return None
    labels = _Labels()
    return Signal(field, lambda value: np.nan if _is_missing(value) else float(labels[value]), takes_text=True)


def _number(value: Any) -> float:
    if value is None:
        return np.nan
    # Text that happens to be a number is refused: it would hide that the wrong field was named.
    if not isinstance(value, bool | int | float | np.number | np.bool_):
        message = f"{value!r:.80} is not a number"
        raise TypeError(message)
    number = float(value)
    if not -EXACT < number < EXACT and isinstance(value, int | np.integer):
        raise ValueError(too_long(int(value)))
    return number


def too_long(value: int) -> str:
    """Say that a whole number is too long."""
    return f"{value} has more digits than float64 holds; record how far it is from a fixed number"


def _discrete(params: DiscreteParams) -> Signal:
    """Return the signal of a discrete action.

    A name is matched as a text. A number counts from 0, unless some name is the text of a number: then numbers are
    matched as names. In the same way true and false are 1 and 0, unless a name is one of the two.
    """
    names = {name: number for number, name in enumerate(params.names)}
    numeric = {float(name): number for name, number in names.items() if _is_number(name)}
    logical = {name.lower(): number for name, number in names.items() if name.lower() in ("true", "false")}
    if len(names) < len(params.names) or len(numeric) < sum(map(_is_number, names)):
        message = f"two actions of '{params.field}' have the same name ({', '.join(params.names)}); rename one"
        raise ParamsError(message)

    def number(value: Any) -> float:
        found: float | None
        if isinstance(value, str):
            found = names.get(value)
        elif logical and isinstance(value, bool | np.bool_):
            found = logical.get(str(value).lower())
        else:
            found = _number(value)
            found = numeric.get(found) if numeric and np.isfinite(found) else found
        if found is None or (np.isfinite(found) and found not in names.values()):
            numbers = "" if numeric else f"0..{len(names) - 1} "
            message = f"{value!r:.80} is none of the actions {numbers}({', '.join(names)})"
            raise ValueError(message)
        return float(found)

    return Signal(params.field, number, names=params.names)


def _is_number(name: str) -> bool:
    try:
        return bool(np.isfinite(float(name)))
    except ValueError:
        return False


def _is_missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and np.isnan(value))
