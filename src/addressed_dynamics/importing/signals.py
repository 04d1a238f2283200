"""What an import takes from a source: one signal per number of a transition, and the spaces that they make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.source import (
    EpisodeByColumn,
    EpisodeByTopic,
    FieldParams,
    McapSource,
    MinariSource,
    SourceParams,
    TableSource,
)
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction, SpaceSpec
from addressed_dynamics.importing.paths import expand_slice


@dataclass(frozen=True)
class Signal:
    """One number of a sample."""

    field: str
    """Its path or column."""
    number: Callable[[Any], float]
    """Makes a number of what is there: NaN if nothing is. Raises TypeError, ValueError or KeyError on what is none."""

    @property
    def plain(self) -> bool:
        """Numbers are taken as they are."""
        return self.number is _number


@dataclass(frozen=True)
class Signals:
    """All numbers of a sample, in order: observation, action, exogenous inputs, reward and label.

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

    @property
    def all(self) -> tuple[Signal, ...]:
        """All signals; their order is that of the columns of `Samples.values`."""
        rest = [signal for signal in (self.reward, self.label) if signal is not None]
        return (*self.observation, *self.action, *self.exogenous, *rest)

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
        return None if self.reward is None else self.exogenous_columns.stop

    @property
    def label_column(self) -> int | None:
        """Column of the label, if there is one."""
        return None if self.label is None else len(self.all) - 1


class _Labels(dict[Any, int]):
    """Numbers labels in the order in which they come."""

    def __missing__(self, label: Any) -> int:
        self[label] = len(self)
        return self[label]


def signals_of(source: SourceParams) -> Signals:
    """Return what `source` asks for.

    Raises:
        ParamsError: a slice is malformed, two dimensions come to have the same name, or bounds are the wrong way round.
    """
    dimensions, observation = _expanded(source.observation)
    space: ContinuousAction | DiscreteAction
    action: tuple[Signal, ...]
    if source.action.discrete is not None:
        names = source.action.discrete.names
        space = DiscreteAction(names)
        action = (Signal(source.action.discrete.field, _action_number(names)),)
    else:
        components, action = _expanded(source.action.continuous or {})
        space = ContinuousAction(components)
    inputs, exogenous = _expanded(source.exogenous)
    return Signals(
        spec=SpaceSpec(dimensions, space, step_seconds=1.0 / source.rate_hz, exogenous=inputs),
        observation=observation,
        action=action,
        reward=None if source.reward is None else Signal(source.reward, _number),
        label=_label(source),
        exogenous=exogenous,
    )


def _expanded(fields: Mapping[str, FieldParams]) -> tuple[tuple[Dimension, ...], tuple[Signal, ...]]:
    dimensions, signals = [], []
    for name, params in fields.items():
        low = -np.inf if params.low is None else params.low
        high = np.inf if params.high is None else params.high
        if low > high:
            message = f"'{name}' has the bounds {low} and {high}, but low should not be above high"
            raise ParamsError(message)
        for place, field in expand_slice(params.field):
            full_name = name if place is None else f"{name}_{place}"
            dimensions.append(Dimension(full_name, params.unit, low, high))
            signals.append(Signal(field, _number))
    names = [dimension.name for dimension in dimensions]
    if len(set(names)) < len(names):
        message = f"two dimensions come to have the same name ({', '.join(names)}); rename one"
        raise ParamsError(message)
    return tuple(dimensions), tuple(signals)


def _label(source: SourceParams) -> Signal | None:
    match source:
        case McapSource(episode=EpisodeByTopic(field=field)) | TableSource(episode=EpisodeByColumn(column=field)):
            labels = _Labels()
            return Signal(field, lambda value: np.nan if _is_missing(value) else float(labels[value]))
        case McapSource() | TableSource() | MinariSource():
            return None


def _number(value: Any) -> float:
    if value is None:
        return np.nan
    # Text that happens to be a number is refused: it would hide that the wrong field was named.
    if not isinstance(value, bool | int | float | np.number | np.bool_):
        message = f"{value!r:.80} is not a number"
        raise TypeError(message)
    return float(value)


def _action_number(names: tuple[str, ...]) -> Callable[[Any], float]:
    numbers = {name: float(number) for number, name in enumerate(names)}

    def number(value: Any) -> float:
        found = numbers.get(value) if isinstance(value, str) else _number(value)
        if found is None or (np.isfinite(found) and found not in numbers.values()):
            message = f"{value!r:.80} is none of the actions 0..{len(names) - 1} ({', '.join(names)})"
            raise ValueError(message)
        return found

    return number


def _is_missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and np.isnan(value))
