"""The report's section on trust: whether intervals and trust can be relied on, how far, and where."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from addressed_dynamics.evaluation.transitions.trust_records import (
    CoverageRecord,
    PlaceRecord,
    RiskRecord,
    ShiftRecord,
    TrustRecord,
)
from addressed_dynamics.evaluation.transitions.trusting import WINDOW
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import Block, Column, Row, Table, Text
from addressed_dynamics.reporting.common.numbers import MISSING, listed, percent, significant
from addressed_dynamics.reporting.transitions.figures.trust import risk_curve, trust_map
from addressed_dynamics.reporting.transitions.results import Arrays

SCORES = {
    "trust": "trust",
    "surprise": "surprise",
    "spread": "spread of seeds",
    "distance": "distance",
    "unlikeness": "Mahalanobis",
    "margin": "margin",
}
"""Title of each score that may tell bad predictions from good ones."""
KINDS = {"starts": "other starts", "behaviour": "another behaviour", "mechanics": "changed mechanics"}
AS_ASKED = "as asked"
"""Of a coverage that is about the share that was asked for."""
SLACK = {1: 0.03}
"""By how much a coverage may miss what was asked, by the steps ahead."""
MOST_DIMENSIONS = 6
"""Dimensions of the state that a place is described by."""
MOST_SLACK = 0.05
"""The same for all other steps."""
TELLS = 0.9
"""AUROC from which on a score is said to tell bad predictions from good ones."""


def trust_blocks(trust: TrustRecord | None, arrays: Arrays, features: FeatureSpec) -> tuple[Block, ...]:
    """Return what is known of the trust of the delivered model; nothing if nothing was measured."""
    if trust is None:
        return ()
    curve, field = risk_curve(trust.risk), trust_map(arrays, features)
    parts: dict[str, Block | None] = {
        "the coverage of intervals": coverage_table(trust.coverage) if trust.coverage else None,
        "the test under shifts": shifts_table(trust.shifts) if trust.shifts else None,
        "the risk against coverage": curve,
        "the map of trust": field,
        "places where more data would help": places_table(trust.places) if trust.places else None,
    }
    missing = [name for name, block in parts.items() if block is None]
    missing += [] if trust.trusted_steps is not None else ["the horizon of trust"]
    missing += [] if trust.knows_break_even else ["the break-even horizon"]
    words = list(_sentences(trust))
    if missing:
        words.append(f"Not measured: {listed(missing)}.")
    return (Text(tuple(words)), *(block for block in parts.values() if block is not None))


def coverage_table(coverage: tuple[CoverageRecord, ...]) -> Table:
    """Return how much of the truth lies in the intervals, by the steps ahead and by what was asked."""
    names = list(dict.fromkeys(name for each in coverage for name in each.dimensions))
    columns = (
        Column("Steps ahead", numeric=False),
        Column("asked"),
        Column("covered"),
        Column("", numeric=False),
        *(Column(name, "covered, by dimension") for name in names),
    )
    rows = tuple(
        Row(
            (
                f"{each.steps:,}",
                percent(each.asked, 0),
                percent(each.of_all),
                _judged(each),
                *(percent(each.dimensions.get(name)) for name in names),
            )
        )
        for each in coverage
    )
    caption = (
        "Intervals on test episodes: the share of the true values that lie in them, beside the share that was asked "
        "for. They were calibrated on validation episodes. Too narrow: the model is surer than it may be, and less "
        "of the truth lies inside than promised; too wide: it is safe, but says less than it could."
    )
    return Table(caption, columns, rows)


def shifts_table(shifts: Mapping[str, ShiftRecord]) -> Table:
    """Return how well each score tells bad predictions from good ones under each shift."""
    found = {score for shift in shifts.values() for score, value in shift.auroc.items() if value is not None}
    scores = [score for score in SCORES if score in found] + sorted(found - set(SCORES))
    absent = [title for score, title in SCORES.items() if score not in found]
    columns = (
        Column("Shift", numeric=False),
        Column("what is changed", numeric=False),
        Column("bad"),
        *(Column(SCORES.get(score, score), "AUROC") for score in scores),
    )
    rows = tuple(
        Row(
            (
                name.replace("_", " "),
                KINDS[shift.kind],
                percent(shift.positive_share),
                *(_area(shift.auroc.get(score)) for score in scores),
            )
        )
        for name, shift in shifts.items()
    )
    caption = (
        "Data that are not like those of the training. Bad: the share of the predictions there whose error is above "
        "the 99th percentile on validation episodes: of a step, or, where the mechanics are changed, of a rollout of "
        f"{WINDOW} steps, with the mean of a score over them. AUROC: how often a bad prediction, there or on test "
        "episodes, gets a worse score than a good one: 1 is always, 0.5 is a coin. Trust is known before a step, "
        "surprise only after it; each of the others is one signal alone."
    )
    if absent:
        caption += f" Not measured: {listed(absent)}."
    return Table(caption, columns, rows)


def places_table(places: tuple[PlaceRecord, ...]) -> Table:
    """Return where in the logs the largest errors are expected."""
    names = list(places[0].state)[:MOST_DIMENSIONS]
    columns = (
        Column("Episode"),
        Column("steps", numeric=False),
        Column("expected", "RMSE, % of the range"),
        Column("made", "RMSE, % of the range"),
        Column("trust"),
        *(Column(name, "mean state") for name in names),
    )
    rows = tuple(
        Row(
            (
                str(each.episode),
                f"{each.step:,}\u2013{each.step + each.steps - 1:,}",
                significant(each.expected_percent),
                significant(each.error_percent),
                f"{each.trust:.2f}",
                *(significant(each.state[name]) for name in names),
            )
        )
        for each in places
    )
    caption = (
        "Where more data would help most: the stretches of validation and test episodes in which the model expects "
        "its largest errors one step ahead, and what it made there. Record more around these states."
    )
    return Table(caption, columns, rows)


def _sentences(trust: TrustRecord) -> Iterator[str]:
    if trust.coverage:
        yield _coverage_sentence(trust.coverage)
    if trust.trusted_steps is not None:
        yield _horizon_sentence(trust, trust.trusted_steps)
    if trust.knows_break_even:
        yield _break_even_sentence(trust)
    if sentence := shifts_sentence(trust.shifts):
        yield sentence
    if sentence := _risk_sentence(trust.risk):
        yield sentence


def _coverage_sentence(coverage: tuple[CoverageRecord, ...]) -> str:
    widest = max(each.asked for each in coverage)
    shown = [each for each in coverage if each.asked == widest]
    parts = [f"{percent(each.of_all)} {_ahead(each.steps)}" for each in shown]
    narrow = [each for each in shown if _judged(each) == "too narrow"]
    end = "Read an interval as what it says."
    if not narrow and any(_judged(each) != AS_ASKED for each in coverage):
        end = "The table says where others are too narrow or too wide."
    if narrow:
        end = f"{listed([_ahead(each.steps).capitalize() for each in narrow])} they are too narrow: allow for more."
    return f"Of the true values, intervals of {percent(widest, 0)} hold {listed(parts)}. {end}"


def _horizon_sentence(trust: TrustRecord, steps: int) -> str:
    share = "a stated share" if trust.trusted_share is None else percent(trust.trusted_share, 0)
    width = f"at most {share} of the range wide in every dimension (median over episodes)"
    if steps == 0:
        return f"There is no horizon of trust: not even one step ahead are its 90\u202f% intervals {width}."
    if steps == trust.rollout_steps:
        return f"Trust the model's rollouts to their end, {_time(trust, steps)}: its 90\u202f% intervals are {width}."
    return (
        f"Trust the model's rollouts for {_time(trust, steps)}: so long its 90\u202f% intervals are {width}. Beyond "
        "that it still says what happens, but no longer closely."
    )


def _break_even_sentence(trust: TrustRecord) -> str:
    steps = trust.break_even_steps
    if steps is None:
        compared = trust.rollout_steps if trust.compared_steps is None else trust.compared_steps
        end = "" if compared is None else f" in rollouts of {_time(trust, compared)}"
        return f"The model is never worse than to say that nothing changes{end}."
    at = "" if trust.step_seconds is None else f" ({significant(steps * trust.step_seconds)} s)"
    return f"From step {steps:,} of a rollout on{at}, to say that nothing changes is the better guess."


def shifts_sentence(shifts: Mapping[str, ShiftRecord]) -> str:
    """Return under which shifts trust warns before a step goes wrong; empty if there are none."""
    areas = {name: (each.auroc.get("trust"), each.auroc.get("surprise")) for name, each in shifts.items()}
    told = [name for name, (before, _) in areas.items() if before is not None and before >= TELLS]
    others = {name: after for name, (before, after) in areas.items() if before is not None and before < TELLS}
    later = [name for name, after in others.items() if after is not None and after >= TELLS]
    never = [name for name in others if name not in later]
    parts = []
    if told:
        parts.append(f"trust warns before a step goes wrong under {_quoted(told)}")
    if later:
        parts.append(f"under {_quoted(later)} only the surprise after the step does")
    if never:
        parts.append(f"under {_quoted(never)} neither does reliably")
    sentence = "; ".join(parts)
    return f"{sentence[0].upper()}{sentence[1:]}." if sentence else ""


def _risk_sentence(risk: tuple[RiskRecord, ...]) -> str:
    half = next((each for each in risk if each.coverage >= 0.5), None)
    if half is None or risk[-1].risk <= 0:
        return ""
    kept, best = (percent(value / risk[-1].risk, 0) for value in (half.risk, half.oracle))
    return (
        f"The {percent(half.coverage, 0)} of the predictions that are trusted most have {kept} of the mean error of "
        f"all; in the best order it would be {best}."
    )


def _judged(each: CoverageRecord) -> str:
    # Shares are read to a tenth of a per cent, and judged as they are read.
    off = round(each.of_all - each.asked, 6)
    if abs(off) <= SLACK.get(each.steps, MOST_SLACK):
        return AS_ASKED
    return "too narrow" if off < 0 else "too wide"


def _ahead(steps: int) -> str:
    return "one step ahead" if steps == 1 else f"{steps:,} steps ahead"


def _time(trust: TrustRecord, steps: int) -> str:
    words = "one step" if steps == 1 else f"{steps:,} steps"
    return words if trust.step_seconds is None else f"{words}, {significant(steps * trust.step_seconds)} s"


def _area(value: float | None) -> str:
    return MISSING if value is None else f"{value:.3f}"


def _quoted(names: list[str]) -> str:
    return listed([f"“{name.replace('_', ' ')}”" for name in names])
