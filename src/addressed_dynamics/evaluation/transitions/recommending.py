"""Which model to deliver: the simplest of those that hold longest on validation episodes, none worse than nothing.

The test episodes have no part in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from jaxtyping import Float32, Float64, Int64

from addressed_dynamics.base.criteria import Criterion
from addressed_dynamics.evaluation.transitions.candidates import Candidate, origin_of
from addressed_dynamics.evaluation.transitions.horizons import (
    median_course,
    one_step_percent,
    percent_of_range,
    steps_until_lost,
)
from addressed_dynamics.evaluation.transitions.one_step import predict_all, squared_errors_per_dimension
from addressed_dynamics.evaluation.transitions.points import Points
from addressed_dynamics.evaluation.transitions.records import ADDRESSED, NOTHING, REFERENCES
from addressed_dynamics.evaluation.transitions.rollouts import roll_out, squared_errors
from addressed_dynamics.evaluation.transitions.truth import TrueRollouts, true_rollouts
from addressed_dynamics.simulators.delivery import Choice, Delivered, Why
from addressed_dynamics.sources.transitions.params import EnvironmentRollouts, RecordedRollouts

SLACK = 1.02
"""An error is no worse than a reference's if it is no more than so many times as large."""
SMALLEST_PERCENT = 0.01
"""Rollouts whose errors are smaller, in % of the range, are equally good."""
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


@dataclass(frozen=True)
class Course:
    """What a candidate reaches in each rollout on validation episodes."""

    percent: Float64[np.ndarray, " rollout"]
    """Root mean square error over the rollout, in % of the range."""
    steps: Float64[np.ndarray, " rollout"]
    """Until it is lost, or all."""
    episode: Int64[np.ndarray, " rollout"]
    """Which it is a stretch of."""

    def clearly_worse(self, other: Course) -> bool:
        """Return whether these rollouts are worse than the same ones of another by more than a standard error.

        What is looked at is the mean of the differences of logarithms, of errors and of horizons, over the episodes:
        stretches of one are alike. From fewer than two episodes nothing is clear.
        """
        errors = [np.log(np.maximum(each.percent, SMALLEST_PERCENT)) for each in (self, other)]
        return any(
            _above_standard_error(each, self.episode)
            for each in (errors[0] - errors[1], np.log(other.steps) - np.log(self.steps))
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
    predicted = roll_out(loadable, truth, cores=cores, device=points.device)
    scores = {each.name: _score(each, points, predicted[each.name], truth) for each in loadable}
    best, better = choose(scores)
    courses = {each.name: _course(points, predicted[each.name], truth) for each in loadable}
    name = simplest(best, scores, courses, {each.name: each.parameters for each in loadable}) if better else best
    (chosen,) = (each for each in loadable if each.name == name)
    record = {
        "candidate": name,
        "label": chosen.label,
        **({"best": best} if best != name else {}),
        "beats_references": not _is_reference(name),
        "rollouts": len(truth.states),
        "scores": {each: asdict(score) for each, score in scores.items()},
    }
    return record, _choice(chosen)


def choose(scores: Mapping[str, Score]) -> tuple[str, bool]:
    """Return the candidate that holds longest, and whether it is worth more than the references.

    It is the best of those that are no worse than any reference in rollouts, nor than nothing one step ahead; if there
    are none, the best of the references that are no worse than another in rollouts: least squares may hold longer than
    nothing does, and then fly off. A reference that is better one step ahead alone is no reason against a model: least
    squares on six frames of Acrobot have a fifth of its error, and are lost in a sixth of the time.
    """
    if not any(map(_is_reference, scores)):
        return min(scores, key=lambda name: scores[name].rank), True
    sound = _no_worse(scores)
    models = [name for name in sound if not _is_reference(name)]
    return min(models or sound, key=lambda name: scores[name].rank), bool(models)


def simplest(
    best: str, scores: Mapping[str, Score], courses: Mapping[str, Course], parameters: Mapping[str, int]
) -> str:
    """Return the candidate to load: the simplest of those that are about as good as the best.

    A few validation episodes do not tell which of several candidates is the best. So those are as good whose rollouts
    are not clearly worse (`Course.clearly_worse`: the rule of one standard error, Breiman et al. 1984), and of these
    those whose error of a step is within `SLACK` of the lowest among them. The one with the fewest parameters is it, a
    reference too; of equally large ones that with the lowest rank.

    Args:
        best: what `choose` returned.
        scores: of all candidates.
        courses: the same rollouts of all.
        parameters: of all.
    """
    alike = [name for name in _no_worse(scores) if name == best or not courses[name].clearly_worse(courses[best])]
    lowest = min(scores[name].one_step_percent for name in alike)
    close = [name for name in alike if scores[name].one_step_percent <= SLACK * lowest]
    return min(close, key=lambda name: (parameters[name], scores[name].rank))


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
    references = [each for each in scores if _is_reference(each)]
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
    one_step = one_step_percent(squared_errors_per_dimension(predict_all(candidate.predictor, points), points), scale)
    squared = squared_errors(predicted, truth)
    whole = percent_of_range(squared.mean(axis=1), scale)
    steps = steps_until_lost(median_course(squared, scale)) or truth.steps
    return Score(one_step, float(np.median(whole)), steps * points.features.spaces.step_seconds)


def _course(points: Points, predicted: Float32[np.ndarray, "episode step state"], truth: TrueRollouts) -> Course:
    squared, scale = squared_errors(predicted, truth), np.array(points.features.scale)
    lost = [steps_until_lost(each) or truth.steps for each in percent_of_range(squared, scale)]
    episode = np.arange(len(lost)) if truth.episode is None else truth.episode
    return Course(percent_of_range(squared.mean(axis=1), scale), np.array(lost, dtype=np.float64), episode)


def _above_standard_error(differences: Float64[np.ndarray, " part"], episode: Int64[np.ndarray, " part"]) -> bool:
    """Return whether the mean of episodes' means is above 0 by more than its standard error; of one episode, no."""
    _, place, count = np.unique(episode, return_inverse=True, return_counts=True)
    means = np.bincount(place, differences) / count
    return len(means) > 1 and bool(means.mean() > means.std(ddof=1) / np.sqrt(len(means)))


def _is_reference(name: str) -> bool:
    return name.partition("/")[0] in REFERENCES


def _no_worse(scores: Mapping[str, Score]) -> list[str]:
    """Return those that are no worse than any reference in rollouts, nor, if trained, than nothing in a step."""
    references = {name: each for name, each in scores.items() if _is_reference(name)}
    nothing = [each.one_step_percent for name, each in references.items() if name.startswith(NOTHING)]
    one_step = SLACK * min(nothing, default=float("inf"))
    rollout = SLACK * min((each.rollout_percent for each in references.values()), default=float("inf"))
    return [
        name
        for name, each in scores.items()
        if each.rollout_percent <= rollout and (name in references or each.one_step_percent <= one_step)
    ]


def _choice(candidate: Candidate) -> Choice:
    origin = origin_of(candidate)
    assert origin is not None
    return Choice(origin.candidate, origin.seed, origin.variant, candidate.mode)
