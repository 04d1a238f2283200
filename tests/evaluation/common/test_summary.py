import math
from typing import Any

import pytest
from report_examples import evaluation_json

from addressed_dynamics.evaluation.common.summary import log10_of, rounded
from addressed_dynamics.evaluation.motion.summary import summarise as summarise_motion
from addressed_dynamics.evaluation.transitions.summary import summarise


def transitions(loss: str = "mse") -> dict[str, Any]:
    report = evaluation_json() | {"loss": loss}
    report["candidates"]["ensemble/argmax"]["multiply_adds"] = 224
    return report


def motion(pfnn: bool = True) -> dict[str, Any]:
    def candidate(group: str, error: float) -> dict[str, Any]:
        return {
            "group": group,
            "multiply_adds": 10,
            "one_step": {"test": {"raw": error, "normalised": error / 4}},
            "closed_loop": {"score": 1 - error, "run": {"lived_seconds": 60.0}},
        }

    others = {"phase_functioned/seed-0": candidate("phase_functioned", 0.5)} if pfnn else {}
    own = {"ensemble/mixture/seed-3": candidate("ensemble/mixture", 0.25)}
    return {"delivered": {"seed": 3, "mode": "mixture"}, "candidates": others | own}


def test_figures_are_kept_as_dvc_shows_them_and_only_if_they_are_numbers() -> None:
    figures = {"a": 1 / 3, "b": None, "c": math.nan, "d": -math.inf, "e": 4}
    assert rounded(figures) == {"a": 0.33333, "e": 4}
    assert log10_of(1e-7) == pytest.approx(-7)
    assert log10_of(0.0) is None
    assert log10_of(None) is None


def test_the_headline_of_transitions_has_the_delivered_model_beside_the_best_other_in_percent() -> None:
    report = transitions()
    own = report["candidates"]["ensemble/argmax"]
    own["one_step"]["scaled"]["mean"] = 4e-4
    others = [name for name in report["candidates"] if not name.startswith("ensemble/")]
    for name in others:
        report["candidates"][name]["one_step"]["scaled"]["mean"] = 9e-4
    found = summarise(report)
    assert (found["one_step_error_percent"], found["one_step_error_percent_best_other"]) == (2.0, 3.0)
    assert summarise(report | {"loss": "mae"})["one_step_error_percent"] == 0.04
    medians = {name: spread["median"] for name, spread in own["rollouts"]["groups"]["all"]["mse"].items()}
    for name, median in medians.items():
        assert found[f"rollout_log10_mse_{name}"] == pytest.approx(math.log10(median), abs=1e-5)
    assert len(found) <= 20


def test_the_headline_of_transitions_without_bounds_says_nothing_of_leaving_them() -> None:
    report = transitions()
    report["candidates"]["ensemble/argmax"]["rollouts"]["left_bounds_share"] = None
    assert set(summarise(transitions())) - set(summarise(report)) == {"rollouts_out_of_bounds_percent"}


def test_the_headline_of_motion_is_that_of_the_delivered_model_and_of_pfnn_if_it_was_trained() -> None:
    found = summarise_motion(motion())
    assert (found["held_out_mae"], found["closed_loop_score"], found["held_out_mae_of_pfnn"]) == (0.25, 0.75, 0.5)
    assert set(found) - set(summarise_motion(motion(pfnn=False))) == {
        "held_out_mae_of_pfnn", "closed_loop_score_of_pfnn"
    }  # fmt: skip
