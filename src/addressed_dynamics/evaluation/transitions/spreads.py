"""Spreads over rollouts: of whole ones, and at each horizon."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float64

from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts

HORIZON_STEP = 10
"""Most steps between two rows of the table of errors against the horizon."""
HORIZON_ROWS = 20
"""Rows that this table has at least, if the rollouts have as many steps."""

ERROR = "error_%"
"""Column of root mean square errors over the dimensions of the state, in % of the range; no dimension is called so."""
INTERVAL = "interval_%"
"""Column of the half widths of 90 % intervals, put together and in the unit of `ERROR`: of the median rollout."""
INTERVAL_OF = "interval.{}"
"""Column of the half width of a dimension, in its unit."""


def against_horizon(
    values: Mapping[str, Float64[np.ndarray, "episode step"]], truth: TrueRollouts
) -> list[dict[str, Any]]:
    """Return rows for a table: each value at each horizon (10th, 50th and 90th percentile), over each group.

    Numbers are rounded to five digits: a curve shows no more, and the table is kept with the code. Of fewer than
    `FEWEST_ROLLOUTS` there is only the median; the others are None.

    Args:
        values: by the name of their columns; of each step of each rollout.
        truth: what the rollouts are held against.
    """
    every = min(HORIZON_STEP, max(1, truth.steps // HORIZON_ROWS))
    rows = []
    for group, members in truth.groups.items():
        if not members.any():
            continue
        known = members.sum() >= FEWEST_ROLLOUTS
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
            numbers = {
                name: float(f"{percentile[index]:.4e}") if known or name.endswith("_p50") else None
                for name, percentile in columns.items()
            }
            rows.append({"group": group, "horizon": horizon, **numbers})
    return rows


def with_intervals(
    rows: Sequence[Mapping[str, Any]], widths: Mapping[str, Float64[np.ndarray, "episode step"]], truth: TrueRollouts
) -> list[dict[str, Any]]:
    """Return the rows of `against_horizon` with how wide intervals are, in the median rollout, where that is known.

    Args:
        rows: of one model.
        widths: half widths by the name of their columns; infinite where none is known.
        truth: what the rollouts are held against.
    """
    medians = {
        (group, name): np.median(each[members], axis=0)
        for group, members in truth.groups.items()
        if members.any()
        for name, each in widths.items()
    }
    found = []
    for row in rows:
        known = {name: float(medians[row["group"], name][row["horizon"] - 1]) for name in widths}
        found.append({**row, **{name: float(f"{width:.4e}") for name, width in known.items() if np.isfinite(width)}})
    return found


def spread(values: Float64[np.ndarray, " rollout"]) -> dict[str, float | None]:
    """Return median, mean, 10th and 90th percentile and maximum; of fewer than `FEWEST_ROLLOUTS` no percentiles."""
    known = len(values) >= FEWEST_ROLLOUTS
    return {
        "median": float(np.median(values)),
        "mean": float(values.mean()),
        "p10": float(np.quantile(values, 0.1)) if known else None,
        "p90": float(np.quantile(values, 0.9)) if known else None,
        "max": float(values.max()),
    }
