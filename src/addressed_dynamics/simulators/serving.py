"""A model as a function of a table with named columns: what MLflow loads as a pyfunc and serves over HTTP.

This knows nothing of MLflow but the form that its pyfunc flavour asks for: a module with a function `_load_pyfunc` that
takes a folder and returns what has a method `predict`. Nothing is unpickled on the way, and no code is in the folder.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from addressed_dynamics.base.errors import ModelError


@dataclass(frozen=True)
class NamedColumn:
    """A column of the table that a model takes, or of the one that it answers with."""

    name: str
    """Its name, that of the column in the Parquet tables if there is one, for instance `observation.position`."""
    unit: str = ""
    """Its unit; empty if it has none."""
    low: float = -np.inf
    """Lowest possible value; minus infinity if unbounded."""
    high: float = np.inf
    """Highest possible value; infinity if unbounded."""
    whole: bool = False
    """Whether its values are whole numbers, such as that of a discrete action."""


class Served(ABC):
    """A model as a function of a table."""

    inputs: tuple[NamedColumn, ...]
    """Columns that it needs."""
    outputs: tuple[NamedColumn, ...]
    """Columns that it answers with."""
    settings: Mapping[str, float]
    """What may be set for a call, with what holds if it is not."""
    facts: Mapping[str, str]
    """Which model it is, for whoever looks for one: candidate, seed, mode and so on."""

    def predict(self, model_input: Any, params: Mapping[str, Any] | None = None) -> Any:
        """Return a data frame of pandas with a row for each that was given.

        Args:
            model_input: a data frame, or anything from the names of columns to their values; further columns are
                ignored.
            params: `settings` that should have other values.

        Raises:
            ModelError: a column is missing or holds what the model cannot take, or there is no such setting.
        """
        import pandas

        given = dict(params or {})
        if unknown := [name for name in given if name not in self.settings]:
            message = f"this model has no setting '{unknown[0]}' (settings: {', '.join(self.settings) or 'none'})"
            raise ModelError(message)
        try:
            columns = {each.name: np.asarray(model_input[each.name]) for each in self.inputs}
        except KeyError as error:
            names = ", ".join(each.name for each in self.inputs[:8])
            message = f"column {error} is missing; this model needs {len(self.inputs)}: {names}"
            raise ModelError(message + (", …" if len(self.inputs) > 8 else "")) from error
        answers = self.answer(columns, {**self.settings, **given})
        return pandas.DataFrame(answers, index=getattr(model_input, "index", None))

    @abstractmethod
    def answer(self, columns: Mapping[str, np.ndarray], settings: Mapping[str, float]) -> dict[str, np.ndarray]:
        """Return the columns of `outputs` for those of `inputs`."""

    @abstractmethod
    def example(self) -> dict[str, np.ndarray]:
        """Return two rows of `inputs` that are like the training data."""


def stacked(columns: Mapping[str, np.ndarray], names: tuple[str, ...]) -> np.ndarray:
    """Return the named columns side by side, (row, column), float32.

    Raises:
        ModelError: one holds no numbers.
    """
    if odd := [name for name in names if columns[name].dtype.kind not in "biuf"]:
        message = f"column '{odd[0]}' should hold numbers, but its type is '{columns[odd[0]].dtype}'"
        raise ModelError(message)
    return np.stack([columns[name] for name in names], axis=1).astype(np.float32)
