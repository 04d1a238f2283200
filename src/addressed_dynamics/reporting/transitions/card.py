"""The model card of an environment or a robot."""

from __future__ import annotations

import math
from collections.abc import Iterator

from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, DiscreteAction
from addressed_dynamics.features.transitions.spec import FeatureSpec
from addressed_dynamics.reporting.common.blocks import (
    NOTHING,
    Block,
    Card,
    Column,
    Facts,
    Front,
    Row,
    Section,
    Table,
    Text,
)
from addressed_dynamics.reporting.common.card import card_of, licence_words
from addressed_dynamics.reporting.common.document import Account
from addressed_dynamics.reporting.common.numbers import MISSING, count, listed, percent, significant
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.common.written import Subject
from addressed_dynamics.reporting.transitions.document import efforts_by_name
from addressed_dynamics.reporting.transitions.overview import overview_table
from addressed_dynamics.reporting.transitions.recorded import DataResult
from addressed_dynamics.reporting.transitions.results import TransitionResults
from addressed_dynamics.reporting.transitions.settings import angle_words, frames_words, target_words
from addressed_dynamics.reporting.transitions.trust import coverage_table, places_table, shifts_sentence

MOST_FILES = 8
"""Logs that a card names."""
DROPPED = ("dropped", "short", "not_finite", "out_of_range")
"""What an import counts of what is not in the data."""


def transitions_card(
    subject: Subject, results: TransitionResults, origin: Origin[FeatureSpec], account: Account
) -> Card:
    """Return the card of a model of states and actions.

    Args:
        subject: the experiment.
        results: what was measured.
        origin: where it comes from.
        account: what the report says.
    """
    front = account.front or NOTHING
    recorded = subject.params.record is not None
    sections = (
        Section("What it predicts", (_predicted(results, origin.features), _quantities(results.data, origin.features))),
        Section("How good it is", tuple(_good(results, front))),
        Section("Which model it is, and why", tuple(_chosen(results, origin, front))),
        Section("Where it knows nothing", tuple(_unknown(results))),
        Section("The data", tuple(_data(results.data, recorded=recorded))),
    )
    return card_of(
        subject, origin, subtitle=account.subtitle, verdict=account.verdict, load=_load(subject, origin.features),
        sections=sections,
    )  # fmt: skip


def _load(subject: Subject, features: FeatureSpec) -> tuple[str, ...]:
    spaces, frames = features.spaces, f"{features.history}, " if features.history > 1 else ""
    discrete = isinstance(spaces.action, DiscreteAction)
    action = f"(B{f', {features.history}' * bool(frames)})" if discrete else _shape(frames, _dimensions(features))
    arguments, shapes = "states, actions", f"{_shape(frames, spaces.observation)} and {action}"
    if spaces.exogenous:
        arguments += ", exogenous=inputs"
        shapes += f" and {_shape(frames, spaces.exogenous)}"
    oldest = ", oldest first" if frames else ""
    return (
        "from addressed_dynamics import AddressedDynamics",
        "",
        f'model = AddressedDynamics.load("{subject.models.as_posix()}")',
        f"model.predict({arguments})  # {shapes}{oldest} -> {_shape('', spaces.observation)}",
    )


def _shape(frames: str, dimensions: tuple[Dimension, ...]) -> str:
    return f"(B, {frames}{len(dimensions)})"


def _dimensions(features: FeatureSpec) -> tuple[Dimension, ...]:
    action = features.spaces.action
    return action.dimensions if isinstance(action, ContinuousAction) else ()


def _predicted(results: TransitionResults, features: FeatureSpec) -> Facts:
    spaces, chosen = features.spaces, results.evaluation.chosen
    action, seconds = spaces.action, spaces.step_seconds
    facts = {
        "Predicts": f"the next state, from the state and the action{' and exogenous inputs' * bool(spaces.exogenous)}",
        "A step": f"{significant(seconds)} s, {significant(1 / seconds)} in a second",
        "It is given": frames_words(features.params),
        "Its networks are asked for": target_words(features.params),
        "Angles": angle_words(features.params) if features.angles else "",
        "Actions": _actions(action) if isinstance(action, DiscreteAction) else "",
        "Size": f"{count(chosen.parameters)} parameters"
        + ("" if chosen.multiply_adds is None else f", {count(chosen.multiply_adds)} multiply-adds a step"),
    }  # fmt: skip
    return Facts({name: value for name, value in facts.items() if value})


def _actions(action: DiscreteAction) -> str:
    return ", ".join(f"{number}: {name}" for number, name in enumerate(action.names))


def _quantities(data: DataResult, features: FeatureSpec) -> Table:
    """Return every number of a step with its unit, its bounds and what was recorded."""
    spaces, scale = features.spaces, dict(zip(features.spaces.observation_names, features.scale, strict=True))
    columns = (
        Column("Quantity", numeric=False),
        Column("role", numeric=False),
        Column("unit", numeric=False),
        Column("bounds"),
        Column("recorded"),
        Column("range"),
    )
    rows = []
    for role, dimensions in (
        ("state", spaces.observation),
        ("action", _dimensions(features)),
        ("exogenous", spaces.exogenous),
    ):
        seen = data.exogenous if role == "exogenous" else data.ranges if role == "state" else {}
        for each in dimensions:
            found = seen.get(each.name)
            rows.append(
                Row(
                    (
                        each.name,
                        role,
                        each.unit or MISSING,
                        _from_to(each.low, each.high),
                        MISSING if found is None else _from_to(found.min, found.max),
                        significant(scale[each.name]) if role == "state" else MISSING,
                    )
                )
            )
    caption = (
        "What a step consists of. Bounds: what is possible, if it is known; recorded: what occurs in the data; range: "
        "what errors in % of the range are a share of: the distance of the bounds or, for lack of them, that of what "
        "training has seen."
    )
    return Table(caption, columns, tuple(rows))


def _from_to(low: float, high: float) -> str:
    if math.isinf(low) and math.isinf(high):
        return MISSING
    return " to ".join(f"{each:.4g}" if math.isfinite(each) else MISSING for each in (low, high))


def _good(results: TransitionResults, front: Front) -> Iterator[Block]:
    yield Facts({name: words for name, words in front.answers.items() if name != "Model"})
    if front.missing:
        yield Text(front.missing)
    if front.errors is not None:
        yield front.errors
    trust = results.evaluation.trust
    if trust is not None and trust.coverage:
        yield coverage_table(trust.coverage)


def _chosen(results: TransitionResults, origin: Origin[FeatureSpec], front: Front) -> Iterator[Block]:
    evaluation = results.evaluation
    yield Facts({"Model": front.answers["Model"], "Of": f"{len(evaluation.candidates)} candidates"})
    if front.sentences:
        yield Text((" ".join(front.sentences),))
    every = overview_table(evaluation, efforts_by_name(results, origin))
    if every is not None:
        yield every


def _unknown(results: TransitionResults) -> Iterator[Block]:
    evaluation, data = results.evaluation, results.data
    coverage, trust = data.coverage, evaluation.trust
    cells = listed([f"{percent(share, 0)} of {name}" for name, share in coverage.per_dimension.items()])
    plane = "" if coverage.plane is None else f" and {percent(coverage.plane, 0)} of the plane of both"
    sentences = [
        f"It has seen nothing beyond what stands under “recorded” above. In a grid of {coverage.cells_per_dimension} "
        f"cells per dimension the data visit {cells}{plane}."
    ]
    if trust is None:
        sentences.append("It cannot say how far it is to be trusted: that was not measured.")
    else:
        sentences.append(
            "`model.trust(states, actions)` is near 0 where it knows nothing, and about 0.5 on data like the "
            "validation episodes."
        )
        sentences.append(shifts_sentence(trust.shifts))
    yield Text((" ".join(each for each in sentences if each),))
    if trust is not None and trust.places:
        yield places_table(trust.places)


def _data(data: DataResult, *, recorded: bool) -> Iterator[Block]:
    facts = {
        "Transitions": count(data.transitions),
        "Repeated": f"{percent(data.duplicates.share)} of them repeat an earlier one",
        "Source": "; ".join(_sources(data)),
        "Licence": licence_words(made_here=recorded),
    }
    yield Facts({name: value for name, value in facts.items() if value})
    rows = [Row((name, count(each.episodes), count(each.transitions))) for name, each in data.splits.items()]
    blocks = ", or blocks in time of long ones," if data.blocks and data.blocks.blocks else ""
    yield Table(
        f"Episodes{blocks} are kept whole: what the model was trained on, chosen by and judged on.",
        (Column("Split", numeric=False), Column("episodes"), Column("transitions")),
        tuple(rows),
    )


def _sources(data: DataResult) -> Iterator[str]:
    """Yield where the data are from: the files of an import, else what was recorded."""
    if data.imported is None:
        for name, each in data.segments.items():
            yield f"{name}: {count(each.transitions)} transitions of {count(each.count)} episodes, by {each.behaviour}"
        return
    files = list(data.imported.files)
    more = f" and {len(files) - MOST_FILES:,} more" if len(files) > MOST_FILES else ""
    rate = "" if data.imported.rate_hz is None else f", at {significant(data.imported.rate_hz)} Hz"
    yield f"{len(files):,} {'file' if len(files) == 1 else 'files'}{rate}: {', '.join(files[:MOST_FILES])}{more}"
    lost = {name: data.imported.totals.get(name, 0) for name in DROPPED}
    yield "left out: " + ", ".join(f"{number:,} {name.replace('_', ' ')}" for name, number in lost.items())
