"""What the evaluation of an experiment comes to."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from addressed_dynamics.simulators.delivery import Delivered


@dataclass(frozen=True)
class Evaluated:
    """All that is measured of an experiment's models."""

    report: dict[str, Any]
    """What goes into evaluation.json."""
    arrays: Mapping[str, np.ndarray]
    """What figures are made of."""
    curves: Mapping[str, list[dict[str, Any]]]
    """Rows of CSV files, by the file's name."""
    headline: dict[str, float]
    """The figures that a table of runs should show."""
    summary: dict[str, float]
    """The few figures that are in Git."""
    delivered: Delivered
    """The model that is delivered."""
