"""The first screen of a report on transitions: which model, its errors in units, and how far to trust it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from addressed_dynamics.episodes.transitions import Dimension
from addressed_dynamics.evaluation.common.bootstrap import FEWEST_ROLLOUTS
from addressed_dynamics.evaluation.transitions.records import (
    ADDRESSED,
    NOTHING,
    CandidateResult,
    ErrorAfter,
    Evaluation,
)
from addressed_dynamics.evaluation.transitions.spreads import ERROR, INTERVAL_OF
from addressed_dynamics.evaluation.transitions.spreads import INTERVAL as INTERVAL_COLUMN
from addressed_dynamics.evaluation.transitions.trust_records import TrustRecord
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import Chart, Column, Figure, Front, Line, Row, Table, View
from addressed_dynamics.reporting.common.charts import places_of, rounded
from addressed_dynamics.reporting.common.figures.style import model_style, with_unit
from addressed_dynamics.reporting.common.missing import missing_words, remedy
from addressed_dynamics.reporting.common.numbers import MISSING, percent, significant
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.common.reading import Columns
from addressed_dynamics.reporting.transitions.comparison import beats, compare
from addressed_dynamics.reporting.transitions.figures.episodes import first_of_each
from addressed_dynamics.reporting.transitions.results import TransitionResults

MOST_DIMENSIONS = 6
"""Dimensions that the first screen has room for: those with the largest errors."""
EVERYTHING = "all, % of the range"
"""What the error over all dimensions is called."""
INTERVAL = "half of the 90 % interval"
"""What the model's own interval is called in charts."""


@dataclass(frozen=True)
class Beside:
    """The delivered model and what it is held against, by the names of candidates."""

    own: str
    """The delivered model."""
    other: str | None
    """The best of the others; None if there is none."""
    nothing: str | None
    """The reference by which nothing changes; None if it was not measured."""

    @property
    def names(self) -> tuple[str, ...]:
        """All of them, in order."""
        return tuple(name for name in (self.own, self.other, self.nothing) if name is not None)


def beside(evaluation: Evaluation) -> Beside:
    """Return what the delivered model is held against.

    The other is the recommended model if that is one of another kind, else the best after about a second of those that
    are.
    """
    own = evaluation.choice.candidate
    nothing = next((name for name in evaluation.candidates if _kind(name) == NOTHING), None)
    found = evaluation.recommendation
    family = own.partition("/")[0]
    if found and found.candidate.partition("/")[0] not in {family, NOTHING}:
        return Beside(own, found.candidate, nothing)
    loadable = set(found.scores) if found else set(evaluation.candidates)
    errors = {
        name: error
        for name, each in evaluation.candidates.items()
        if name in loadable and name.partition("/")[0] != family and name != nothing
        if (error := _middle_error(each)) is not None
    }
    return Beside(own, min(errors, key=lambda name: errors[name]) if errors else None, nothing)


def front(results: TransitionResults, origin: Origin[FeatureSpec], film: Figure | None) -> Front:
    """Return the first screen.

    Args:
        results: what was measured.
        origin: where it comes from.
        film: a rollout that one can see; None if there is none.
    """
    evaluation = results.evaluation
    shown = beside(evaluation)
    chart = error_chart(results, shown, origin.features)
    return Front(
        answers={
            "Model": f"{evaluation.chosen.label}{_why(evaluation)}",
            "Trust it for": trusted_words(evaluation.trust),
        },
        load=(
            "from addressed_dynamics import AddressedDynamics; "
            f'model = AddressedDynamics.load("data/models/{origin.experiment}")'
        ),
        sentences=_sentences(evaluation, shown),
        errors=error_table(evaluation, shown, origin.features),
        film=film,
        chart=chart,
        missing=_missing(evaluation, origin.experiment, charted=chart is not None),
    )


def title_of(evaluation: Evaluation, name: str) -> str:
    """Return the short title of a candidate, with its seed unless it is delivered, or the first of its kind."""
    if name.startswith("ensemble/") and _kind(name) != ADDRESSED:
        return evaluation.candidates[name].label
    title, own = model_style(name)[0], evaluation.choice.candidate
    first = next(each for each in evaluation.candidates if _kind(each) == _kind(name))
    if name == own or (name == first and _kind(own) != _kind(name)):
        return title
    seed = name.partition("/seed-")[2] or str(evaluation.delivered.seed)
    return f"{title}, seed {seed}"


def error_table(evaluation: Evaluation, shown: Beside, features: FeatureSpec) -> Table | None:
    """Return the errors after a step, a second and ten, in units and in % of the range; None if not measured."""
    found = {name: _moments(evaluation.candidates[name]) for name in shown.names}
    times = found[shown.own]
    if not times:
        return None
    seconds, scale = features.spaces.step_seconds, _scale(features)
    at = {(name, each.steps): each for name, group in found.items() for each in group}
    columns = [Column("Error", numeric=False)]
    columns += [
        Column(_headed(evaluation, shown, name), _after(each, seconds)) for each in times for name in shown.names
    ]
    pairs = [(name, each.steps) for each in times for name in shown.names]
    rows = [Row((EVERYTHING, *(_percent_cell(at.get(pair)) for pair in pairs)), "own")]
    for dimension in _largest(times[-1], features):
        cells = (_unit_cell(at.get(pair), dimension.name, scale) for pair in pairs)
        rows.append(Row((with_unit(dimension.name, dimension.unit), *cells)))
    return Table(_error_caption(evaluation, times), tuple(columns), tuple(rows))


def _error_caption(evaluation: Evaluation, times: Sequence[ErrorAfter]) -> str:
    """Say over what the errors at these moments are, and why one step may have the largest."""
    what = "Root mean square error on held-out episodes, in the unit and, in brackets, in % of the range"
    later = [each for each in times if not _of_all(evaluation.chosen, each)]
    if len(later) == len(times):
        return f"{what}, over {min(each.rollouts for each in times):,} rollouts."
    whole = f"{what}: of one step over all {evaluation.test.transitions:,} test transitions"
    if not later:
        return f"{whole}."
    rollouts = f"{whole}, then over {min(each.rollouts for each in later):,} rollouts"
    if times[0].percent <= later[0].percent:
        return f"{rollouts}."
    first = significant(evaluation.chosen.errors_after[0].percent, 2)
    return f"{rollouts}, which begin where it is easier (their first steps: {first}\u202f%)."


def error_chart(results: TransitionResults, shown: Beside, features: FeatureSpec) -> Chart | None:
    """Return the error of the median rollout against its length; None if there are no rollouts."""
    evaluation, horizon = results.evaluation, results.horizon.get("all", {})
    names = [name for name in shown.names if name in horizon]
    if not names:
        return None
    others = [name for name in first_of_each(horizon) if name in evaluation.candidates and name not in names]
    seconds, scale = features.spaces.step_seconds, _scale(features)
    steps = horizon[names[0]]["horizon"]
    kept = places_of(steps)
    widths = _half_widths(horizon[names[0]], evaluation.chosen, scale)
    known = {*steps.astype(int).tolist(), *(step for width in widths.values() for step in width)}
    moments = {each.steps for each in evaluation.chosen.errors_after} & known
    places = sorted({int(steps[place]) for place in kept} | moments)
    several = _rollouts(evaluation.chosen) >= FEWEST_ROLLOUTS

    def lines(dimension: Dimension | None) -> tuple[Line, ...]:
        drawn = []
        for name in (*names, *others):
            style = model_style(name, horizon)
            dashed = name == shown.nothing or (name != shown.own and _kind(name) == _kind(shown.own))
            line = Line(
                title_of(evaluation, name), style[1], _course(horizon[name], "p50", dimension, scale, places),
                style="dashed" if dashed else "line", shown=name in names,
            )  # fmt: skip
            if name == shown.own and several and not widths:
                low, high = (_course(horizon[name], share, dimension, scale, places) for share in ("p10", "p90"))
                line = replace(line, low=low, high=high)
            drawn.append(line)
        if widths:
            width = widths.get(EVERYTHING if dimension is None else dimension.name, {})
            half = tuple(rounded(width.get(step)) for step in places)
            drawn.insert(len(names), Line(INTERVAL, model_style(shown.own)[1], half, style="area"))
        return tuple(drawn)

    views = [View((EVERYTHING,), "error, % of the range", tuple(step * seconds for step in places), lines(None))]
    views += [
        View((each.name,), f"error of {with_unit(each.name, each.unit)}", views[0].places, lines(each))
        for each in features.spaces.observation
    ]
    band = ", with its 10th to 90th percentile" if several and not widths else ""
    caption = f"Error against the length of a rollout, in the median of {_rollouts(evaluation.chosen):,}{band}."
    alternative = (
        f"Error in rollouts against their length, for {', '.join(title_of(evaluation, name) for name in names)}"
    )
    return Chart(
        "horizon", caption, alternative, "seconds since the true state", tuple(views), ("Error of",), logarithmic=True
    )


def trusted_words(trust: TrustRecord | None) -> str:
    """Return for how long rollouts can be trusted, and by what measure."""
    if trust is None or trust.trusted_steps is None:
        return "not measured"
    share = percent(trust.trusted_share, 0)
    within = f"its 90\u202f% intervals are at most {share} of the range wide"
    if trust.trusted_steps == 0:
        return f"not even a step, if {within.replace('are', 'are to be', 1)}"
    time = "" if trust.step_seconds is None else f"{significant(trust.trusted_steps * trust.step_seconds)} s, "
    whole = "all of " if trust.trusted_steps == trust.rollout_steps else ""
    steps = "1 step" if trust.trusted_steps == 1 else f"{trust.trusted_steps:,} steps"
    return f"{whole}{time}{steps}: so long {within}"


def no_rollouts(experiment: str) -> str:
    """Say that there are no rollouts, and what makes some."""
    return (
        "There are no rollouts, so nothing is known beyond one step: record longer episodes, or lower "
        f"evaluation.rollouts.steps, and run '{remedy('evaluate', experiment)}'."
    )


def _why(evaluation: Evaluation) -> str:
    why = {
        "asked": "as the params file asks",
        "best": "the best on validation episodes, or the simplest of those that are about as good",
        "reference": "no trained model is worth more on validation episodes",
        "unmeasured": "there are no validation episodes to choose by",
    }
    return f" ({why[evaluation.choice.why]})"


def _sentences(evaluation: Evaluation, shown: Beside) -> tuple[str, ...]:
    found = [_recommended(evaluation), _against(evaluation, shown), _break_even(evaluation.trust)]
    return tuple(sentence for sentence in found if sentence)


def _recommended(evaluation: Evaluation) -> str:
    """Say which model is the better choice on validation episodes, if it is not what is delivered."""
    found = evaluation.recommendation
    if found is None or found.candidate == evaluation.choice.candidate:
        return ""
    label = found.label if found.label.startswith("one ") else f"the {found.label}"
    return f'On validation episodes {label} does better over whole rollouts: load it with candidate="recommended".'


def _against(evaluation: Evaluation, shown: Beside) -> str:
    """Hold the delivered model against the best other one; no difference is called one that chance could make."""
    if shown.other is None:
        return ""
    title = f"“{title_of(evaluation, shown.other)}”"
    if _kind(shown.own) != ADDRESSED:
        return f"Whether it differs from {title} by more than chance was not tested."
    group = evaluation.baseline(_kind(shown.other))
    if not group or _rollouts(evaluation.chosen) < FEWEST_ROLLOUTS:
        few = _rollouts(evaluation.chosen)
        return f"With {few} rollouts, fewer than {FEWEST_ROLLOUTS}, no difference from {title} can be told from chance."
    comparisons = compare(evaluation.own_seeds, group)
    relations = {each.relation for each in comparisons}
    if relations == {"unclear"}:
        return f"No clear difference from {title}, the best of the others: chance could make it."
    if relations <= {"worse", "unclear"}:
        return f"It is no better than {title}, which has clearly lower errors in part."
    return f"It {beats(comparisons)} {title}, the best of the others, by more than chance."


def _break_even(trust: TrustRecord | None) -> str:
    if trust is None or not trust.knows_break_even:
        return ""
    steps = trust.break_even_steps
    if steps is None:
        return "It is never worse than to say that nothing changes."
    at = f"step {steps:,}" if trust.step_seconds is None else f"{significant(steps * trust.step_seconds)} s"
    return f"From {at} of a rollout on, to say that nothing changes is the better guess."


def _missing(evaluation: Evaluation, experiment: str, *, charted: bool) -> tuple[str, ...]:
    chosen, found = evaluation.chosen, []
    if chosen.rollouts is None:
        found.append(no_rollouts(experiment))
    elif not chosen.errors_after:
        found.append(missing_words("The errors after a step, 1 s and 10 s in units are", "evaluate", experiment))
    if chosen.rollouts is not None and not charted:
        found.append(missing_words("The errors against the length of rollouts are", "evaluate", experiment))
    if evaluation.trust is None:
        found.append(
            "How far to trust it is missing: it takes a second trained seed (ensemble.seeds) and "
            f"'{remedy('evaluate', experiment)}'."
        )
    return tuple(found)


def _kind(name: str) -> str:
    return name.partition("/seed-")[0]


def _middle_error(candidate: CandidateResult) -> float | None:
    """Return the error after about a second, or one step ahead where there is none; None if that is unknown, too."""
    times = candidate.errors_after
    return times[len(times) // 2].percent if times else candidate.one_step.percent


def _rollouts(candidate: CandidateResult) -> int:
    return candidate.rollouts.all.number if candidate.rollouts else 0


def _scale(features: FeatureSpec) -> dict[str, float]:
    return dict(zip(features.spaces.observation_names, features.scale, strict=True))


def _headed(evaluation: Evaluation, shown: Beside, name: str) -> str:
    return "this model" if name == shown.own else "no change" if name == shown.nothing else title_of(evaluation, name)


def _after(each: ErrorAfter, step_seconds: float) -> str:
    steps = "1 step" if each.steps == 1 else f"{each.steps:,} steps"
    return f"after {steps}, {each.steps * step_seconds:.3g} s"


def _largest(last: ErrorAfter, features: FeatureSpec) -> Sequence[Dimension]:
    """Return the dimensions with the largest errors in % of the range, in their own order."""
    scale = _scale(features)
    known = [each for each in features.spaces.observation if each.name in last.dimensions]
    largest = sorted(known, key=lambda each: -last.dimensions[each.name] / scale[each.name])[:MOST_DIMENSIONS]
    return [each for each in known if each in largest]


def _of_all(candidate: CandidateResult, error: ErrorAfter) -> bool:
    """Return whether an error is shown over all test transitions, and not over the rollouts."""
    return error.steps == 1 and candidate.one_step.percent is not None


def _moments(candidate: CandidateResult) -> Sequence[ErrorAfter]:
    """Return the errors after some moments; those one step ahead are over all test transitions.

    What is said of one step elsewhere is over these, too: the first steps of the rollouts are few, and seldom hold what
    is rare, as a bump into a wall. Results of earlier versions have them alone.
    """
    one_step = candidate.one_step
    units = {each.name: each.squared.mean**0.5 for each in one_step.dimensions}
    return [
        each.model_copy(
            update={
                "percent": one_step.percent,
                "dimensions": {name: units.get(name, first) for name, first in each.dimensions.items()},
            }
        )
        if _of_all(candidate, each)
        else each
        for each in candidate.errors_after
    ]


def _percent_cell(error: ErrorAfter | None) -> str:
    return MISSING if error is None else f"{significant(error.percent, 2)}\u202f%"


def _unit_cell(error: ErrorAfter | None, name: str, scale: Mapping[str, float]) -> str:
    if error is None or name not in error.dimensions:
        return MISSING
    value = error.dimensions[name]
    return f"{significant(value, 2)} ({significant(100 * value / scale[name], 2)})"


def _course(
    columns: Columns, share: str, dimension: Dimension | None, scale: Mapping[str, float], places: Sequence[int]
) -> tuple[float | None, ...]:
    """Return the error at each of these steps, in the unit of a dimension, or of all in % of the range."""
    if dimension is not None:
        values = np.sqrt(columns[f"{dimension.name}_{share}"])
    elif f"{ERROR}_{share}" in columns:
        values = columns[f"{ERROR}_{share}"]
    else:  # results of earlier versions
        values = 100 * np.sqrt(
            np.mean([columns[f"{name}_{share}"] / width**2 for name, width in scale.items()], axis=0)
        )
    known = _by_step(columns, values)
    return tuple(rounded(known.get(place)) for place in places)


def _half_widths(
    columns: Columns, chosen: CandidateResult, scale: Mapping[str, float]
) -> dict[str, Mapping[int, float]]:
    """Return half of the 90 % interval by dimension, and over all of them in % of the range, and then by step.

    Where they were not measured against the horizon, those after a step, 1 s and 10 s; nothing if there are none.
    """
    if INTERVAL_COLUMN in columns:
        found = {name: columns[INTERVAL_OF.format(name)] for name in scale if INTERVAL_OF.format(name) in columns}
        found[EVERYTHING] = columns[INTERVAL_COLUMN]
        return {name: _by_step(columns, values) for name, values in found.items()}
    known = {each.steps: each.interval for each in chosen.errors_after if each.interval}
    if not known:
        return {}
    widths: dict[str, Mapping[int, float]] = {
        name: {steps: each[name] for steps, each in known.items() if name in each} for name in scale
    }
    widths[EVERYTHING] = {
        steps: 100 * float(np.sqrt(np.mean([(each[name] / scale[name]) ** 2 for name in each if name in scale])))
        for steps, each in known.items()
    }
    return widths


def _by_step(columns: Columns, values: Float[np.ndarray, " horizon"]) -> dict[int, float]:
    return dict(zip(columns["horizon"].astype(int).tolist(), values.tolist(), strict=True))
