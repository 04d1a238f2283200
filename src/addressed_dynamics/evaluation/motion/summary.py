"""The headline of an experiment with motion."""

from typing import Any

from addressed_dynamics.evaluation.common.summary import rounded

PFNN = "phase_functioned"
"""Group of the phase-functioned networks that were trained here."""


def summarise(report: dict[str, Any]) -> dict[str, float]:
    """Return the headline of an evaluation: at most 20 numbers.

    Errors of one step are mean absolute errors on clips that were held out whole, in the outputs' own units and
    normalised; those of the closed loop are from the standard script.

    Args:
        report: what goes into evaluation.json.
    """
    delivered, candidates = report["delivered"], report["candidates"]
    own = candidates[f"ensemble/{delivered['mode']}/seed-{delivered['seed']}"]
    pfnn = next((each for each in candidates.values() if each["group"] == PFNN), None)
    figures: dict[str, float | None] = {
        "held_out_mae": own["one_step"]["test"]["raw"],
        "held_out_mae_normalised": own["one_step"]["test"]["normalised"],
        "closed_loop_score": own["closed_loop"]["score"],
        "closed_loop_lived_seconds": own["closed_loop"]["run"]["lived_seconds"],
        "multiply_adds_a_step": own["multiply_adds"],
    }
    if pfnn is not None:
        figures |= {
            "held_out_mae_of_pfnn": pfnn["one_step"]["test"]["raw"],
            "closed_loop_score_of_pfnn": pfnn["closed_loop"]["score"],
        }
    return rounded(figures)
