"""What the stage `train_policy` wrote, read and checked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from addressed_dynamics.policies.records import ARRAYS, CURVE, FIGURES, INDEX, PolicyFigures
from addressed_dynamics.reporting.common.reading import Columns, read_arrays, read_csv, read_json


@dataclass(frozen=True)
class PolicyResult:
    """What the stage `train_policy` wrote."""

    figures: PolicyFigures
    curves: Mapping[str, Columns]
    """learning.csv by who learned: `model` or `truth`."""
    state: Float[np.ndarray, "step observation"] | None = None
    """States of the true episodes, before each decision; None, like the next, without them or without trust."""
    trust: Float[np.ndarray, " step"] | None = None
    """The model's trust in each of these; NaN before it had seen enough frames."""


def read_policy(folder: Path) -> PolicyResult | None:
    """Read what the stage `train_policy` wrote; None if the experiment asks for no policy, or if nothing was run.

    Raises:
        ReportError: a file is missing or malformed.
    """
    if not folder.is_dir() or read_json(folder / INDEX, dict[str, object]).get("policy") is None:
        return None
    arrays = read_arrays(
        folder / ARRAYS, lambda file: {name: file[name] for name in ("state", "trust") if name in file}
    )
    curves = read_csv(folder / CURVE, by="learner", needed=("decisions", "return", "ended"))
    return PolicyResult(read_json(folder / FIGURES, PolicyFigures), curves, **arrays)
