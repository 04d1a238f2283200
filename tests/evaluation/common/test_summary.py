import json
import math
from typing import Any

import pytest
from report_examples import evaluation_json

from addressed_dynamics.evaluation.common.summary import log10_of, rounded
from addressed_dynamics.evaluation.motion.summary import summarise as summarise_motion
from addressed_dynamics.evaluation.transitions.summary import summarise


def transitions() -> dict[str, Any]:
    report: dict[str, Any] = json.loads(json.dumps(evaluation_json()))  # some candidates share parts
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


SCALE = {"position": 2.0, "velocity": 0.1}
COURSE = [  # of a rollout whose errors are 1 %, 10 % and 40 % of the range in both dimensions
    {"model": "ensemble/argmax", "group": "all", "horizon": steps, "position_p50": (2 * share) ** 2,
     "velocity_p50": (0.1 * share) ** 2}
    for steps, share in ((10, 0.01), (20, 0.1), (30, 0.4))
]  # fmt: skip


def of_transitions(report: dict[str, Any], course: list[dict[str, Any]] = COURSE) -> dict[str, float]:
    elsewhere = [row | {"group": "wall", "position_p50": 9.0} for row in course]
    return summarise(report, [*elsewhere, *course], SCALE, 0.5)


def with_errors(candidate: dict[str, Any], share: float) -> None:
    """Let each dimension be off by a share of its range, one step ahead."""
    candidate["one_step"]["dimensions"] = [
        {"name": name, "squared": {"mean": (share * scale) ** 2}} for name, scale in SCALE.items()
    ]


def test_the_headline_of_transitions_has_errors_in_percent_of_the_range_beside_the_best_other() -> None:
    report = transitions()
    for name, candidate in report["candidates"].items():
        with_errors(candidate, 0.02 if name == "ensemble/argmax" else 0.03)
    found = of_transitions(report)
    assert (found["one_step_rmse_percent"], found["one_step_rmse_percent_best_other"]) == (2.0, 3.0)
    assert found["rollout_rmse_percent_after_10_steps"] == 1.0
    assert found["rollout_rmse_percent_after_30_steps"] == 40.0
    spreads = report["candidates"]["ensemble/argmax"]["rollouts"]["groups"]["all"]["mse"]
    for name, spread in spreads.items():
        assert found[f"rollout_log10_mse_{name}"] == pytest.approx(math.log10(spread["median"]), abs=1e-5)
    assert len(found) <= 20
    assert 0.0 not in found.values()


def test_a_rollout_lasts_until_its_error_is_a_tenth_of_the_range_or_to_its_end() -> None:
    assert of_transitions(transitions())["rollout_horizon_seconds"] == 20 * 0.5
    assert of_transitions(transitions(), COURSE[:1])["rollout_horizon_seconds"] == 10 * 0.5
    assert "rollout_horizon_seconds" not in of_transitions(transitions(), [])


def test_the_headline_of_transitions_without_bounds_says_nothing_of_leaving_them() -> None:
    report = transitions()
    report["candidates"]["ensemble/argmax"]["rollouts"]["left_bounds_share"] = None
    assert set(of_transitions(transitions())) - set(of_transitions(report)) == {"rollouts_out_of_bounds_percent"}


def test_the_headline_of_motion_is_that_of_the_delivered_model_and_of_pfnn_if_it_was_trained() -> None:
    found = summarise_motion(motion())
    assert (found["held_out_mae"], found["closed_loop_score"], found["held_out_mae_of_pfnn"]) == (0.25, 0.75, 0.5)
    assert set(found) - set(summarise_motion(motion(pfnn=False))) == {
        "held_out_mae_of_pfnn", "closed_loop_score_of_pfnn"
    }  # fmt: skip
