"""Steps that float32 swallows: counted in each file, and refused where most of a dimension's are lost."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numpy as np

from addressed_dynamics.base.errors import TableError
from addressed_dynamics.episodes.precision import Swallowed, swallowed
from addressed_dynamics.importing.samples import Recorded, dimension_columns
from addressed_dynamics.importing.signals import Signals


@dataclass(frozen=True)
class LostSteps:
    """What float32 swallows of one recording."""

    steps: Swallowed
    """Of each dimension in the order of `dimension_columns`."""
    middles: dict[str, float]
    """The median of each dimension that loses steps."""


def lost_steps(recorded: Recorded, signals: Signals) -> LostSteps:
    """Count the steps of a recording that float32 swallows."""
    dimensions = dimension_columns(signals.spec)
    columns = [each.column for each in dimensions]
    found = reduce(
        Swallowed.merge, (swallowed(each.values[:, columns], each.follows) for each in recorded.overlapping())
    )
    middles = {}
    for each, count in zip(dimensions, found.lost, strict=True):
        if count:
            column = np.concatenate([block.values[:, each.column] for block in recorded.blocks()])
            middles[each.name] = float(np.median(column))
    return LostSteps(found, middles)


class Precision:
    """Adds up what float32 swallows.

    Args:
        signals: what is imported.
    """

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._dimensions = dimension_columns(signals.spec)
        nothing = np.zeros(len(self._dimensions), dtype=np.int64)
        self._total = Swallowed(nothing, nothing)
        self._first: dict[str, tuple[str, float]] = {}

    def add(self, lost: LostSteps, origin: str) -> dict[str, int]:
        """Add what was found in a file; return the steps that are lost, by dimension; zeros left out."""
        self._total = self._total.merge(lost.steps)
        for name, middle in lost.middles.items():
            self._first.setdefault(name, (origin, middle))
        return {each.name: int(count) for each, count in zip(self._dimensions, lost.steps.lost, strict=True) if count}

    def refuse_swallowed(self) -> None:
        """Do nothing if float32 keeps at least half of the steps of each dimension.

        Raises:
            TableError: it does not.
        """
        for message in self.refusals():
            raise TableError(message)

    def refusals(self) -> Iterator[str]:
        """Yield a line for each dimension of which float32 loses most steps."""
        for place in np.flatnonzero(self._total.mostly):
            name, signal = self._dimensions[place].name, self._signals.all[self._dimensions[place].column]
            origin, middle = self._first[name]
            yield (
                f"{origin}: float32 cannot hold '{name}' (field '{signal.field}'): {self._total.lost[place]} of the "
                f"{self._total.changed[place]} steps that change it are lost, because its values are near {middle:.9g} "
                f"and change by little; give it an offset that is taken off, such as {signal.offset + round(middle)}"
            )
