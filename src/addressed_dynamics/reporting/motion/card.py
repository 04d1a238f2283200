"""The model card of motion."""

from __future__ import annotations

from collections.abc import Iterator

from addressed_dynamics.episodes.layout import FRAME_RATE, INPUT, OUTPUT, Layout
from addressed_dynamics.evaluation.motion.records import UNCALIBRATED
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
from addressed_dynamics.reporting.common.numbers import MISSING, count, listed, significant
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.common.written import Subject
from addressed_dynamics.reporting.motion.recorded import MotionData, Speeds, summary
from addressed_dynamics.reporting.motion.results import MotionResults
from addressed_dynamics.reporting.motion.settings import model_words
from addressed_dynamics.sources.motion.params import MotionFeatureParams


def motion_card(
    subject: Subject, results: MotionResults, origin: Origin[MotionFeatureParams], account: Account
) -> Card:
    """Return the card of a model of motion.

    Args:
        subject: the experiment.
        results: what was measured.
        origin: where it comes from.
        account: what the report says.
    """
    front = account.front or NOTHING
    sections = (
        Section("What it predicts", (_predicted(results, origin.features), _blocks(INPUT, "Inputs"),
                                     _blocks(OUTPUT, "Outputs"))),
        Section("How good it is", tuple(_good(front))),
        Section("Which model it is, and why", tuple(_chosen(results, front))),
        Section("Where it knows nothing", (Text(tuple(_unknown(results.data))),)),
        Section("The data", tuple(_data(results.data))),
    )  # fmt: skip
    load = (
        "from addressed_dynamics import MotionModel",
        "",
        f'model = MotionModel.load("{subject.models.as_posix()}")',
        f"model.predict(x)  # (B, {INPUT.width}) -> (B, {OUTPUT.width})",
    )
    return card_of(
        subject, origin, subtitle=account.subtitle, verdict=account.verdict, load=load, sections=sections
    )  # fmt: skip


def _predicted(results: MotionResults, features: MotionFeatureParams) -> Facts:
    own, words = results.evaluation.own, model_words(features, results.evaluation.delivered.mode)
    multiply_adds = "" if own.multiply_adds is None else f", {count(own.multiply_adds)} multiply-adds a frame"
    return Facts(
        {
            "Predicts": f"the next frame of a character under commands: {OUTPUT.width} numbers from {INPUT.width}",
            "A step": f"1/{FRAME_RATE} s",
            "It is given": words.given["Inputs"],
            "Its networks are asked for": words.predicted,
            "Size": f"{count(own.parameters)} parameters{multiply_adds}",
        }
    )


def _blocks(layout: Layout, title: str) -> Table:
    columns = (Column(title, numeric=False), Column("numbers"), Column("unit", numeric=False))
    rows = (
        Row((each.name.replace("_", " "), count(len(each.columns)), each.unit or MISSING)) for each in layout.blocks
    )
    caption = f"{title}, in their order: in the frame of the root, y upwards, z where the character faces; unbounded."
    return Table(caption, columns, tuple(rows))


def _good(front: Front) -> Iterator[Block]:
    yield Facts({name: words for name, words in front.answers.items() if name != "Model"})
    if front.errors is not None:
        yield front.errors


def _chosen(results: MotionResults, front: Front) -> Iterator[Block]:
    evaluation = results.evaluation
    why = "the addressed ensemble and the mode with the highest score in the closed loop under validation scripts"
    yield Facts({"Model": f"{front.answers['Model']}: {why}", "Of": f"{len(evaluation.candidates)} candidates"})
    if front.sentences:
        yield Text((" ".join(front.sentences),))
    if evaluation.recommendation is None:
        return
    rows = tuple(
        Row(
            (evaluation.candidates[name].label, significant(each.closed_loop), significant(each.mae_normalised)),
            "own" if name == evaluation.own_name else "",
        )
        for name, each in evaluation.recommendation.scores.items()
    )
    yield Table(
        "What the models that can be loaded reach on validation scripts and frames, by which is chosen: score of 1, "
        "and mean absolute error of a frame in units of each output's deviation.",
        (Column("Model", numeric=False), Column("closed loop"), Column("error of a frame")),
        rows,
    )


def _unknown(data: MotionData) -> Iterator[str]:
    absent = [gait for gait, share in data.gaits.items() if not share]
    if absent:
        yield f"Gaits that it has never seen: {listed(absent)}."
    speeds = data.speed.get("all")
    if isinstance(speeds, Speeds):
        yield (
            f"Of the frames 5\u202f% are slower than {significant(speeds.q05)} cm/s and 5\u202f% faster than "
            f"{significant(speeds.q95)} cm/s; beyond that it has seen little."
        )
    if data.quality.flat_terrain:
        yield "The ground is flat everywhere in the data: it knows no slope and no step."
    yield f"It does not say itself how far it is to be trusted: {UNCALIBRATED}."


def _data(data: MotionData) -> Iterator[Block]:
    yield Text(summary(data))
    yield Facts({"Licence": licence_words(made_here=data.made_up)})
