"""Spreads over the episodes of rollouts: of whole rollouts, and at each horizon."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.evaluation.transitions.truth import TrueRollouts

HORIZON_STEP = 10
"""Most steps between two rows of the table of errors against the horizon."""
HORIZON_ROWS = 20
"""Rows that this table has at least, if the rollouts have as many steps."""


def against_horizon(
    values: Mapping[str, Float64[np.ndarray, "episode step"]], truth: TrueRollouts
) -> list[dict[str, Any]]:
    """Return rows for a table: each value at each horizon (10th, 50th and 90th percentile), over each group.

    Numbers are rounded to five digits: a curve shows no more, and the table is kept with the code.

    Args:
        values: by the name of their columns; of each step of each rollout.
        truth: what the rollouts are held against.
    """
    every = min(HORIZON_STEP, max(1, truth.steps // HORIZON_ROWS))
    rows = []
    for group, members in truth.groups.items():
        if not members.any():
            continue
        columns = {
            f"{name}_{label}": percentile
            for name, each in values.items()
            for label, percentile in zip(
                ("p10", "p50", "p90"),
                np.quantile(each[members, every - 1 :: every], [0.1, 0.5, 0.9], axis=0),
                strict=True,
            )
        }
        for index, horizon in enumerate(range(every, truth.steps + 1, every)):
            numbers = {name: float(f"{percentile[index]:.4e}") for name, percentile in columns.items()}
            rows.append({"group": group, "horizon": horizon, **numbers})
    return rows


def spread(values: Float64[np.ndarray, " episode"]) -> dict[str, float]:
    """Return median, mean, 10th and 90th percentile and maximum over episodes."""
    return {
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "p10": float(np.quantile(values, 0.1)),
        "p90": float(np.quantile(values, 0.9)),
        "max": float(values.max()),
    }
