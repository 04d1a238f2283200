"""The model card: what a model predicts, how well, from what data, and where it knows nothing, beside its files."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from addressed_dynamics.base.errors import ModelError
from addressed_dynamics.reporting.common.blocks import Block, Card, Facts, Section, Text
from addressed_dynamics.reporting.common.missing import remedy
from addressed_dynamics.reporting.common.origin import Origin
from addressed_dynamics.reporting.common.written import Subject
from addressed_dynamics.simulators.delivery import Parts, find_parts

NAME = "README.md"
"""Name of the file in a folder of models; the report writes it."""


def card_of(
    subject: Subject,
    origin: Origin[Any],
    *,
    subtitle: str,
    verdict: str,
    load: Sequence[str],
    sections: Sequence[Section],
) -> Card:
    """Return a card of what a kind of data has to say, and of which files, recipe and versions are behind it.

    Args:
        subject: the experiment.
        origin: where its results come from.
        subtitle: what kind of model it is.
        verdict: the result in one or two sentences.
        load: lines of Python that load the model and ask it.
        sections: what the kind has to say.
    """
    everything = (*sections, Section("Files and versions", (_files(subject, origin),)))
    kept = tuple(section for section in everything if section.blocks)
    return Card(f"{origin.title}: model card", subtitle, verdict, tuple(load), kept)


def plain_card(subject: Subject, verdict: str) -> Card:
    """Return the card of a kind of data that supplies none: the verdict, and the report that has the rest."""
    models = subject.models.as_posix()
    load = (
        "from addressed_dynamics.simulators.delivery import read_delivered",
        f'print(read_delivered("{models}"))  # which of the models is delivered',
    )
    words = f"All that was measured is in the report of '{remedy('report', subject.experiment)}'."
    return Card(f"{subject.params.title}: model card", "", verdict, load, (Section("More", (Text((words,)),)),))


def licence_words(*, made_here: bool) -> str:
    """Return what is known of the licence of the data."""
    if made_here:
        return "the data were made by this package itself, from its params; nobody else's are in them"
    return "unknown: logs do not say theirs; ask whoever recorded them before you pass the model on"


def _files(subject: Subject, origin: Origin[Any]) -> Block:
    versions = ", ".join(f"{name} {number}" for name, number in origin.versions.items())
    facts = {
        "Params": f"`{origin.params_file}`, section `{subject.experiment}`",
        "Networks": _networks(subject),
        "Versions": versions,
        "Report": f"[report.html](../../reports/{subject.experiment}/report.html)",
        "Licence": "of the program MIT; of the model that of the data, see there",
    }
    return Facts({name: value for name, value in facts.items() if value})


def _networks(subject: Subject) -> str:
    """Return the folders of the delivered model with digests of their files; nothing if that cannot be told."""
    try:
        parts: Parts = find_parts(subject.models, None, None, None)
    except ModelError:
        return ""
    folders = [each for each in (parts.network, parts.addressing) if each is not None]
    names = [folder.relative_to(subject.models).as_posix() for folder in folders]
    return ", ".join(f"`{name}` ({subject.runs[name]})" if name in subject.runs else f"`{name}`" for name in names)
