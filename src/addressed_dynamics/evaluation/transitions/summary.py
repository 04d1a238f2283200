"""The headline of an experiment with transitions."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from addressed_dynamics.evaluation.common.summary import log10_of, rounded
from addressed_dynamics.evaluation.transitions.horizons import LOST_PERCENT
from addressed_dynamics.evaluation.transitions.reward_records import TaskRecord
from addressed_dynamics.simulators.rewards import LEARNED

OWN = "ensemble/"
"""First part of the names of our own candidates."""
DELIVERED = "ensemble/argmax"
DIMENSIONS_SHOWN = 10
"""Dimensions of the state that have a figure of their own."""


def summarise(
    report: Mapping[str, Any], horizon: Sequence[Mapping[str, Any]], scale: Mapping[str, float], step_seconds: float
) -> dict[str, float]:
    """Return the headline of an evaluation: at most 23 numbers.

    Errors in percent are root mean squares over the dimensions of the state, each in % of its range. Those of rollouts
    are of the median episode; a horizon is the time after which this error reaches `LOST_PERCENT`, or the length of the
    rollouts. `rollout_log10_mse_*` is the base-10 logarithm of the median episode's mean squared error over the whole
    rollout, in the unit of the dimension squared.

    Figures of the learned reward and end are there only if the logs have rewards, or ends.

    Args:
        report: what goes into evaluation.json.
        horizon: rows of errors against the horizon.
        scale: range of each dimension of the state, in its unit.
        step_seconds: length of a step.
    """
    delivered, candidates = report["delivered"], report["candidates"]
    table = report["seeds"][str(delivered["seed"])][delivered["variant"]]
    own = candidates[DELIVERED]
    others = [_one_step(each, scale) for name, each in candidates.items() if not name.startswith(OWN)]
    course = [
        (row["horizon"], _percent({name: row[f"{name}_p50"] for name in scale}, scale))
        for row in horizon
        if row["model"] == DELIVERED and row["group"] == "all"
    ]
    spreads = own["rollouts"]["groups"]["all"]["mse"]
    median = {name: spread["median"] if spread else None for name, spread in spreads.items()}
    left = own["rollouts"]["left_bounds_share"]
    return rounded(
        {
            "best_network_chosen_percent": 100 * table["agreement"],
            "one_step_rmse_percent": _one_step(own, scale),
            "one_step_rmse_percent_best_other": min(others, default=None),
            **{f"rollout_rmse_percent_after_{steps}_steps": error for steps, error in course[:1] + course[-1:]},
            "rollout_horizon_seconds": _horizon(course, step_seconds),
            **{f"rollout_log10_mse_{name}": log10_of(median[name]) for name in list(median)[:DIMENSIONS_SHOWN]},
            "rollouts_out_of_bounds_percent": None if left is None else 100 * left,
            "multiply_adds_a_step": own["multiply_adds"],
            **_learned_task(report.get("reward")),
        }
    )


def _learned_task(record: Mapping[str, Any] | None) -> dict[str, float | None]:
    """Return how well reward and end were learned from the logs, if these have some."""
    learned = None if record is None else TaskRecord.model_validate(record).judged.get(LEARNED)
    if learned is None:
        return {}
    return {
        "learned_reward_rmse": learned.reward_rmse,
        "false_ends_per_thousand_steps": learned.false_ends_per_thousand,
        "missed_ends_per_thousand": learned.missed_ends_per_thousand,
    }


def _one_step(candidate: Mapping[str, Any], scale: Mapping[str, float]) -> float:
    means = {each["name"]: each["squared"]["mean"] for each in candidate["one_step"]["dimensions"]}
    return _percent({name: means[name] for name in scale}, scale)


def _percent(squared: Mapping[str, float], scale: Mapping[str, float]) -> float:
    return 100 * math.sqrt(sum(error / scale[name] ** 2 for name, error in squared.items()) / len(squared))


def _horizon(course: Sequence[tuple[int, float]], step_seconds: float) -> float | None:
    if not course:
        return None
    lost = [steps for steps, error in course if error >= LOST_PERCENT]
    return (lost[0] if lost else course[-1][0]) * step_seconds
