"""A model of states and actions as a function of a table."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import final

import numpy as np

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.episodes.parquet import column_names
from addressed_dynamics.episodes.transitions import Dimension, DiscreteAction
from addressed_dynamics.simulators.addressed import AddressedDynamics
from addressed_dynamics.simulators.serving import NamedColumn, Served, stacked

COVERAGE = "coverage"
"""Setting with the share of cases in which the next state should lie between its ends."""
USUAL_COVERAGE = 0.9
TRUST = "trust"
"""Column with the trust in each row."""


@final
class ServedTransitions(Served):
    """The step of a model, with its intervals and its trust if they were calibrated.

    The columns are those of the Parquet tables, so that a table of transitions is a table of inputs. With a history of
    H > 1 frames those of the frames before have the number of steps in their names: `observation.position.-1`.
    """

    def __init__(self, model: AddressedDynamics) -> None:
        """Look at what a model takes.

        Raises:
            ModelError: a file of its trust is missing or damaged.
        """
        self.model = model
        spaces, history = model.features.spaces, model.features.history
        self._suffixes = tuple(f".{step}" if step else "" for step in range(1 - history, 1))
        self._discrete = isinstance(spaces.action, DiscreteAction)
        observation = _columns("observation", spaces.observation)
        if isinstance(spaces.action, DiscreteAction):
            action: tuple[NamedColumn, ...] = (NamedColumn("action", "", 0, spaces.action.count - 1, whole=True),)
        else:
            action = _columns("action", spaces.action.dimensions)
        exogenous = _columns("exogenous", spaces.exogenous)
        self._roles = [tuple(each.name for each in columns) for columns in (observation, action, exogenous)]
        frame = (*observation, *action, *exogenous)
        self.inputs = tuple(
            NamedColumn(f"{each.name}{suffix}", each.unit, each.low, each.high, each.whole)
            for suffix in self._suffixes
            for each in frame
        )
        self._next = tuple(column_names("next_observation", spaces.observation))
        following = _columns("next_observation", spaces.observation)
        trust = model.trusted_if_calibrated()
        self._trusted = trust is not None
        self.settings: Mapping[str, float] = {}
        ends: tuple[NamedColumn, ...] = ()
        if trust is not None:
            ends = (
                *(NamedColumn(f"{each.name}.{end}", each.unit) for end in ("low", "high") for each in following),
                NamedColumn(TRUST, "", 0.0, 1.0),
            )
            # Few validation episodes calibrate few coverages.
            self.settings = {COVERAGE: min(max(USUAL_COVERAGE, trust.coverages[0]), trust.coverages[-1])}
        self.outputs = (*following, *ends)
        origin = model.origin
        self.facts = {
            "kind": "transitions",
            "mode": model.mode,
            "history": str(history),
            "step_seconds": f"{spaces.step_seconds:g}",
            **({} if origin is None else {"candidate": origin.candidate, "seed": str(origin.seed)}),
            **({} if origin is None or origin.variant is None else {"variant": origin.variant}),
        }

    def answer(self, columns: Mapping[str, np.ndarray], settings: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Return the next states, and with trust the ends of their intervals and the trust in each row.

        Raises:
            ModelError: a value is not finite, an action does not exist, or there is no such coverage.
        """
        observation, action, exogenous = (self._frames(columns, names) for names in self._roles)
        if self._discrete:
            action = self._numbers(columns)
        if len(self._suffixes) == 1:
            observation = observation[:, 0]
        known = exogenous if exogenous.shape[-1] else None
        if not self._trusted:
            one = len(self._suffixes) == 1
            acted, given = (action[:, 0], None if known is None else known[:, 0]) if one else (action, known)
            following = self.model.predict(observation, acted, exogenous=given)
            return dict(zip(self._next, following.T, strict=True))
        states, low, high, trust = self.model.rollout(
            observation, action, exogenous=known, with_trust=True, coverage=settings[COVERAGE]
        )
        parts = ((states, ""), (low, ".low"), (high, ".high"))
        found = {
            f"{name}{end}": column for part, end in parts for name, column in zip(self._next, part[:, 0].T, strict=True)
        }
        return found | {TRUST: trust[:, 0]}

    def example(self) -> dict[str, np.ndarray]:
        """Return the mean of the training inputs, and what is one deviation from it, within the bounds."""
        features = self.model.features
        spaces = features.spaces
        mean, deviation = np.array(features.input_mean), np.array(features.input_deviation)
        rows = np.stack([mean, mean + deviation])
        states, known = len(spaces.observation), len(spaces.exogenous)
        parts = (rows[:, :states], rows[:, states : rows.shape[1] - known], rows[:, rows.shape[1] - known :])
        values: dict[str, np.ndarray] = {}
        for names, part in zip(self._roles, parts, strict=True):
            if names == ("action",) and self._discrete:
                values["action"] = np.array([0, len(mean) - states - known - 1])
            else:
                values |= dict(zip(names, part.T, strict=True))
        bounds = {each.name: (each.low, each.high) for each in self.inputs}
        return {
            f"{name}{suffix}": column if name == "action" and self._discrete else column.clip(*bounds[name])
            for suffix in self._suffixes
            for name, column in values.items()
        }

    def _frames(self, columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
        """Return columns of each frame, oldest first, (row, frame, column); without rows of none."""
        rows = len(next(iter(columns.values())))
        if not names:
            return np.empty((rows, len(self._suffixes), 0), np.float32)
        frames = [stacked(columns, tuple(f"{name}{suffix}" for name in names)) for suffix in self._suffixes]
        return np.stack(frames, axis=1)

    def _numbers(self, columns: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the discrete action of each frame, (row, frame)."""
        numbers = np.stack([columns[f"action{suffix}"] for suffix in self._suffixes], axis=1)
        if numbers.dtype.kind not in "iuf" or not (numbers == np.round(numbers)).all():
            message = "column 'action' should hold the numbers of actions, which are whole"
            raise ModelError(message)
        return numbers.astype(np.int64)


def load_served(folder: Path) -> ServedTransitions:
    """Load what is delivered of the models in a folder as a function of a table.

    Raises:
        ModelError: a file is missing or damaged.
    """
    return ServedTransitions(AddressedDynamics.load(folder))


def _load_pyfunc(path: str) -> ServedTransitions:
    """Load a model; MLflow calls it."""
    return load_served(Path(path))


def _columns(role: str, dimensions: tuple[Dimension, ...]) -> tuple[NamedColumn, ...]:
    names = column_names(role, dimensions)
    return tuple(
        NamedColumn(name, each.unit, each.low, each.high) for name, each in zip(names, dimensions, strict=True)
    )
