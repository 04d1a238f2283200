"""All candidates beside each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.evaluation.transitions.records import (
    ADDRESSED,
    CandidateResult,
    EpisodeSpread,
    Evaluation,
)
from addressed_dynamics.reporting.common.blocks import Chart, Line, View
from addressed_dynamics.reporting.common.charts import numbers
from addressed_dynamics.reporting.common.figures.style import model_style, with_unit

_Spread = tuple[float, float, float]
"""Lower end, middle and upper end."""


def candidates(evaluation: Evaluation, dimensions: Sequence[Dimension]) -> Chart:
    """Return each candidate's one-step and rollout errors as a range with its middle."""
    named = evaluation.candidates
    one_step = {
        name: (each.one_step.scaled.median, each.one_step.scaled.mean, each.one_step.scaled.p99)
        for name, each in named.items()
    }
    views = [_view("one step", f"{evaluation.loss.upper()} of scaled states", one_step, named)]
    for dimension in dimensions:
        spreads = {
            name: _ends(spread)
            for name, each in named.items()
            if each.rollouts and (spread := each.rollouts.all.mse.get(dimension.name))
        }
        label = f"mean square over a rollout: {with_unit(dimension.name, dimension.unit)}"
        views += [_view(f"rollouts, {dimension.name}", label, spreads, named)] if spreads else []
    caption = (
        "All candidates; further left is better. One step: mean error (dot) between the median and the 99th "
        "percentile of all test transitions (bar); a mean beyond the bar comes from a few large errors. Rollouts: "
        "mean squared error of whole rollouts, median (dot) and 10th to 90th percentile (bar; of at least "
        f"{FEWEST_ROLLOUTS}) over rollouts."
    )
    alternative = "One-step and rollout errors of every candidate, each with its spread"
    return Chart("candidates", caption, alternative, "", tuple(views), ("Error in",), form="ranges")


def _view(choice: str, label: str, spreads: Mapping[str, _Spread], named: Mapping[str, CandidateResult]) -> View:
    lines = tuple(
        Line(_short(name, named[name]), model_style(name, named)[1], numbers([middle]), numbers([low]), numbers([high]))
        for name, (low, middle, high) in spreads.items()
    )
    return View((choice,), label, (), lines)


def _short(name: str, candidate: CandidateResult) -> str:
    if name == ADDRESSED:
        return model_style(name)[0]
    if not name.startswith("ensemble/"):
        title = model_style(name)[0]
        seed = name.partition("/seed-")[2]
        return f"{title}, seed {seed}" if seed not in {"", "0"} else title
    return candidate.label.removeprefix("ensemble, ").replace(" addressing", "")


def _ends(spread: EpisodeSpread) -> tuple[float, float, float]:
    """Return 10th percentile, median and 90th percentile; the median thrice where rollouts are too few for others."""
    low, high = (spread.median if each is None else each for each in (spread.p10, spread.p90))
    return low, spread.median, high
