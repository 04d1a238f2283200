"""Which model of motion is recommended: of those near the best closed loop, the one with the lowest error of a step."""

import pytest
import torch
from motions import make_motion

from addressed_dynamics.evaluation.motion.candidates import MotionCandidate
from addressed_dynamics.evaluation.motion.one_step import block_deviation, one_step_errors
from addressed_dynamics.evaluation.motion.recommending import TIE, Score, choose, recommend
from addressed_dynamics.simulators.delivery import Choice

VALIDATION = make_motion(24, seed=1)
DEVIATION = block_deviation(VALIDATION.y)


@pytest.mark.parametrize(
    ("score", "expected"),
    [(0.80, "same_size/seed-0"), (0.81 - TIE, "same_size/seed-0"), (0.7, "ensemble/argmax/seed-0")],
)
def test_a_network_of_a_member_s_size_wins_if_it_is_no_worse_in_the_closed_loop(score: float, expected: str) -> None:
    scores = {
        "ensemble/argmax/seed-0": Score(0.81, 0.557),
        "phase_functioned/seed-0": Score(0.52, 0.1),
        "same_size/seed-0": Score(score, 0.478),
    }
    assert choose(scores) == expected


def off_by(error: float, group: str, seed: int | None) -> MotionCandidate:
    """A model that is off by so much in all that it says."""
    outputs = torch.from_numpy(VALIDATION.y) + error
    return MotionCandidate(group, seed, f"about {group}", 7, lambda x, phase: outputs)  # noqa: ARG005 - a predictor is given both


def test_only_what_was_trained_here_and_does_not_draw_is_recommended() -> None:
    candidates = [
        off_by(0.3, "ensemble/argmax", 0),
        off_by(0.1, "ensemble/sample", 0),
        off_by(0.2, "ensemble/blend", 4),
        off_by(0.25, "same_size", 2),
        off_by(0.0, "ridge", None),
    ]
    results = {each.name: {"closed_loop": {"validation_score": 0.5}} for each in candidates}
    record, choice = recommend(candidates, results, VALIDATION, DEVIATION)
    assert choice == Choice("ensemble", 4, None, "blend")
    assert (record["candidate"], record["label"]) == ("ensemble/blend/seed-4", "about ensemble/blend")
    assert list(record["scores"]) == ["ensemble/argmax/seed-0", "ensemble/blend/seed-4", "same_size/seed-2"]
    expected = one_step_errors(candidates[2].predictor, VALIDATION, DEVIATION).normalised
    assert record["scores"]["ensemble/blend/seed-4"] == {"closed_loop": 0.5, "mae_normalised": expected}
    results["same_size/seed-2"]["closed_loop"]["validation_score"] = 0.6
    assert recommend(candidates, results, VALIDATION, DEVIATION)[1] == Choice("same_size", 2, None, None)
