"""The headline of an experiment with transitions."""

import math
from typing import Any

from addressed_dynamics.evaluation.common.summary import log10_of, rounded

OWN = "ensemble/"
"""First part of the names of our own candidates."""


def summarise(report: dict[str, Any]) -> dict[str, float]:
    """Return the headline of an evaluation: at most 20 numbers.

    Errors of one step are root mean squares (mean absolute errors, if that is the reported loss) of states scaled to
    [0, 1], in %; those of rollouts the base-10 logarithm of the median episode's mean squared error, in the unit of the
    dimension squared.

    Args:
        report: what goes into evaluation.json.
    """
    delivered = report["delivered"]
    table = report["seeds"][str(delivered["seed"])][delivered["variant"]]
    candidates = report["candidates"]
    own = candidates["ensemble/argmax"]
    others = [each["one_step"]["scaled"]["mean"] for name, each in candidates.items() if not name.startswith(OWN)]
    median = {
        name: spread["median"] if spread else None for name, spread in own["rollouts"]["groups"]["all"]["mse"].items()
    }
    left = own["rollouts"]["left_bounds_share"]
    return rounded(
        {
            "best_network_chosen_percent": 100 * table["agreement"],
            "one_step_error_percent": _percent(own["one_step"]["scaled"]["mean"], report["loss"]),
            "one_step_error_percent_best_other": _percent(min(others), report["loss"]) if others else None,
            **{f"rollout_log10_mse_{name}": log10_of(value) for name, value in list(median.items())[:14]},
            "rollouts_out_of_bounds_percent": None if left is None else 100 * left,
            "multiply_adds_a_step": own["multiply_adds"],
        }
    )


def _percent(loss: float, kind: str) -> float:
    return 100 * (math.sqrt(loss) if kind == "mse" else loss)
