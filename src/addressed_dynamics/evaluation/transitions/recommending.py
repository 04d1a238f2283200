"""Which model to deliver: the one that holds longest on validation episodes, and never one that is worse than nothing.

The test episodes have no part in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32

from addressed_dynamics.base.criteria import Criterion
from addressed_dynamics.evaluation.transitions.candidates import Candidate, origin_of
from addressed_dynamics.evaluation.transitions.horizons import (
    median_course,
    one_step_percent,
    percent_of_range,
    steps_until_lost,
)
from addressed_dynamics.evaluation.transitions.one_step import errors_per_dimension, predict_all
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import ADDRESSED, NOTHING, REFERENCES
from addressed_dynamics.evaluation.transitions.rollouts import roll_out, squared_errors
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, true_rollouts
from addressed_dynamics.simulators.delivery import Choice, Delivered, Why
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts

SLACK = 1.02
"""An error is no worse than a reference's if it is no more than so many times as large."""
MOST_ROLLOUTS = 40
"""Rollouts of each candidate beside the environment, under behaviours that neither training nor test has seen."""


@dataclass(frozen=True)
class Score:
    """What a candidate reaches on validation episodes; errors are root mean squares in % of the range."""

    one_step_percent: float
    rollout_percent: float
    """Over a whole rollout, of the median episode."""
    horizon_seconds: float
    """Until the median rollout is lost, or the length of the rollouts."""

    @property
    def rank(self) -> tuple[float, float, float]:
        """The lower the better: horizon first, then the error of rollouts, then that of a step."""
        return -self.horizon_seconds, self.rollout_percent, self.one_step_percent

    def criteria(self) -> tuple[Criterion, ...]:
        """Return what `rank` compares, to be compared with a model of another run."""
        return (
            Criterion("horizon_seconds", self.horizon_seconds, higher_is_better=True),
            Criterion("rollout_percent", self.rollout_percent, higher_is_better=False),
            Criterion("one_step_percent", self.one_step_percent, higher_is_better=False),
        )


def recommend(
    candidates: Sequence[Candidate],
    points: Points,
    params: EnvironmentRollouts | RecordedRollouts,
    segments: Mapping[int, str],
    *,
    cores: int,
) -> tuple[dict[str, Any], Choice] | None:
    """Return what goes into evaluation.json, and which model is recommended; None without validation episodes.

    Args:
        candidates: all that can be loaded, and others.
        points: those of the validation episodes.
        params: which rollouts; those beside an environment begin from another seed than the test's.
        segments: segment of each episode.
        cores: rollouts at the same time.
    """
    if not len(points):
        return None
    if isinstance(params, EnvironmentRollouts):
        others = {"seed": params.seed + 1, "episodes": min(params.episodes, MOST_ROLLOUTS)}
        params = params.model_copy(update=others)
    truth = true_rollouts(params, points.transitions, points.features.history, dict(segments))
    # A model that draws its members answers otherwise each time.
    loadable = [each for each in candidates if each.model is not None and each.mode != "sample"]
    predicted = roll_out(loadable, truth, cores=cores)
    scores = {each.name: _score(each, points, predicted[each.name], truth) for each in loadable}
    name, better = choose(scores)
    (chosen,) = (each for each in loadable if each.name == name)
    record = {
        "candidate": name,
        "label": chosen.label,
        "beats_references": better,
        "rollouts": len(truth.states),
        "scores": {each: asdict(score) for each, score in scores.items()},
    }
    return record, _choice(chosen)


def choose(scores: Mapping[str, Score]) -> tuple[str, bool]:
    """Return the candidate to load, and whether it is worth more than the references.

    It is the best of those that are no worse than any reference in rollouts, nor than nothing one step ahead; if there
    are none, the best of the references that are no worse than another in rollouts: least squares may hold longer than
    nothing does, and then fly off. A reference that is better one step ahead alone is no reason against a model: least
    squares on six frames of Acrobot have a fifth of its error, and are lost in a sixth of the time.
    """
    references = {name: each for name, each in scores.items() if name.partition("/")[0] in REFERENCES}
    if not references:
        return min(scores, key=lambda name: scores[name].rank), True
    nothing = [each.one_step_percent for name, each in references.items() if name.startswith(NOTHING)]
    one_step = SLACK * min(nothing, default=float("inf"))
    rollout = SLACK * min(each.rollout_percent for each in references.values())
    sound = {
        name: each
        for name, each in scores.items()
        if name not in references and each.one_step_percent <= one_step and each.rollout_percent <= rollout
    }
    among = sound or {name: each for name, each in references.items() if each.rollout_percent <= rollout}
    return min(among, key=lambda name: among[name].rank), bool(sound)


def deliver(
    asked: Literal["best", "addressed"], own: Choice, found: tuple[Mapping[str, Any], Choice] | None
) -> tuple[Delivered, str]:
    """Return what is delivered, with the reason and with what it reaches, and the name of the candidate that it is.

    Args:
        asked: `best`, or `addressed` for the addressed ensemble whatever it reaches.
        own: the addressed ensemble.
        found: what `recommend` returned.
    """
    why: Why = "asked"
    if found is None:
        why = "unmeasured" if asked == "best" else why
        return Delivered(own.seed, own.variant, own.mode, why=why), ADDRESSED
    record, best = found
    scores = {name: Score(**each) for name, each in record["scores"].items()}
    name, chosen = ADDRESSED, own
    if asked == "best":
        name, chosen = record["candidate"], best
        why = "best" if record["beats_references"] else "reference"
    references = [each for each in scores if each.partition("/")[0] in REFERENCES]
    beside = [name, ADDRESSED, *sorted(references, key=lambda each: scores[each].rank)[:1]]
    delivered = Delivered(
        chosen.seed,
        chosen.variant,
        chosen.mode,
        recommended=best,
        candidate=chosen.candidate,
        ensemble=None if chosen == own else own,
        why=why,
        scores={each: asdict(scores[each]) for each in dict.fromkeys(beside)},
    )
    return delivered, name


def _score(
    candidate: Candidate, points: Points, predicted: Float32[np.ndarray, "episode step state"], truth: TrueRollouts
) -> Score:
    scale = np.array(points.features.scale)
    one_step = one_step_percent(errors_per_dimension(predict_all(candidate.predictor, points), points), scale)
    squared = squared_errors(predicted, truth)
    whole = percent_of_range(squared.mean(axis=1), scale)
    steps = steps_until_lost(median_course(squared, scale)) or truth.steps
    return Score(one_step, float(np.median(whole)), steps * points.features.spaces.step_seconds)


def _choice(candidate: Candidate) -> Choice:
    origin = origin_of(candidate)
    assert origin is not None
    return Choice(origin.candidate, origin.seed, origin.variant, candidate.mode)
