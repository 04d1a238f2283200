"""Which model of motion to load: of those that do best in the closed loop, the one with the lowest error of a step.

Scripts and frames for validation decide; the test script and the held-out clips have no part in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from jaxtyping import Float

from addressed_dynamics.base.criteria import Criterion
from addressed_dynamics.episodes.motion import Motion
from addressed_dynamics.evaluation.motion.candidates import ENSEMBLE, MotionCandidate
from addressed_dynamics.evaluation.motion.one_step import one_step_errors
from addressed_dynamics.simulators.delivery import Choice

TIE = 0.02
"""Scores of the closed loop that differ by no more than this are as good as each other: seeds alone differ by more."""


@dataclass(frozen=True)
class Score:
    """What a candidate reaches on validation data."""

    closed_loop: float
    """Score under the validation scripts, 0 to 1; the higher the better."""
    mae_normalised: float
    """Mean absolute error of a step on validation frames, in units of each output's deviation."""

    def criteria(self) -> tuple[Criterion, ...]:
        """Return what `choose` compares, to be compared with a model of another run."""
        return (
            Criterion("closed_loop", self.closed_loop, higher_is_better=True, tie=TIE),
            Criterion("mae_normalised", self.mae_normalised, higher_is_better=False),
        )


def recommend(
    candidates: Sequence[MotionCandidate],
    results: Mapping[str, Mapping[str, Any]],
    validation: Motion,
    deviation: Float[Any, " 311"],
) -> tuple[dict[str, Any], Choice]:
    """Return what goes into evaluation.json, and which model is recommended.

    Args:
        candidates: all that were measured; those that were trained here can be loaded, but for the mode that draws.
        results: what was measured of each, by its name.
        validation: frames that nothing was trained on.
        deviation: as in `one_step_errors`.
    """
    scores = {
        each.name: Score(
            float(results[each.name]["closed_loop"]["validation_score"]),
            one_step_errors(each.predictor, validation, deviation).normalised,
        )
        for each in candidates
        if each.seed is not None and each.group != f"{ENSEMBLE}/sample"
    }
    name = choose(scores)
    (chosen,) = (each for each in candidates if each.name == name)
    record = {
        "candidate": name,
        "label": chosen.label,
        "scores": {each: asdict(score) for each, score in scores.items()},
    }
    kind, _, mode = chosen.group.partition("/")
    assert chosen.seed is not None
    return record, Choice(kind, chosen.seed, None, mode or None)


def choose(scores: Mapping[str, Score]) -> str:
    """Return the candidate with the lowest error of those whose score in the closed loop is near the best."""
    best = max(each.closed_loop for each in scores.values())
    near = [name for name, each in scores.items() if each.closed_loop >= best - TIE]
    return min(near, key=lambda name: scores[name].mae_normalised)
