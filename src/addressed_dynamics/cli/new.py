"""`addressed-dynamics new`: from somebody's files to an experiment that the pipeline runs."""

from __future__ import annotations

import io
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError
from ruamel.yaml import YAML

from addressed_dynamics.base.errors import LogError, ParamsError
from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.cli.inspection import inspect_file
from addressed_dynamics.episodes.transitions import LEARNED
from addressed_dynamics.importing.assessing import Assessment, assess
from addressed_dynamics.importing.finding import Found, find_logs
from addressed_dynamics.importing.looking import Look
from addressed_dynamics.importing.looking_at import look_at
from addressed_dynamics.importing.proposing import Proposal, Wishes, propose

MAPPINGS = ("experiments", "recorded", "imported")
"""Mappings at the top of a params file that name experiments."""
FEW, LONG = 10, 500
"""Fewer episodes than these, one of which has more steps than those, are split in blocks in time."""
SHORT = 1_600
"""Fewer steps than these make fewer than 20 blocks, of which a tenth is one for validation: too few to choose by."""
SMALL = 50_000
"""Fewer transitions than these are seen more often in training, by smaller networks, and through rollouts."""
SMALL_ENSEMBLE = (
    "hidden: 32-32", "activation: tanh", "linear: true", "loss: mae", "optimiser: {learning_rate: 0.003}",
    "batch_size: 128", "weight_decay: 0.1", "epochs: 40", "early_stopping: 15", "horizon: 4", "cluster_epochs: 5",
)  # fmt: skip
"""How an ensemble is trained on so few."""

_PLAIN = re.compile(r"[\w./-]+")
_SOURCE: TypeAdapter[Any] = TypeAdapter(SourceParams)


@dataclass(frozen=True)
class Trial:
    """What is known of some files before they are imported."""

    found: Found
    look: Look
    proposal: Proposal
    assessment: Assessment | None
    """None as long as something has to be said first."""

    def to_json(self) -> dict[str, Any]:
        """Return everything as JSON-compatible values."""
        return {
            "kind": self.look.kind,
            "files": list(self.found.patterns),
            "fields": [
                {"field": each.field, "values": each.total, "rate_hz": each.rate_hz, "unit": each.unit,
                 "range": each.range, "texts": sorted(each.texts)}
                for each in self.look.fields
            ],
            "stamps": [vars(stamp) for stamp in self.look.stamps],
            "unread": self.look.unread,
            "source": self.proposal.source,
            "guessed": list(self.proposal.guessed),
            "unknown": list(self.proposal.unknown),
            "assessment": None if self.assessment is None else self.assessment.to_json(),
        }  # fmt: skip


@dataclass(frozen=True)
class Recorded:
    """What is known of logs of transitions, which need no import."""

    lengths: list[int]
    """Steps of every episode."""
    predicted: list[Path]
    """The logs that hold what a learned model predicted, and nothing that happened."""


def try_import(paths: list[Path], wishes: Wishes) -> Trial:
    """Look at files, propose how to import them and, if nothing has to be said first, judge what would come out.

    Raises:
        LogError: there are no files, or one is damaged.
        TableError: the same of tables.
        ParamsError: a wish names what is not there.
    """
    found = find_logs(paths)
    look = look_at(found, wishes.types)
    proposal = propose(look, found.patterns, wishes)
    assessment = None if proposal.unknown else assess(source_params(proposal.source))
    return Trial(found, look, proposal, assessment)


def source_params(source: Mapping[str, Any]) -> SourceParams:
    """Check a section `source`.

    Raises:
        ParamsError: something in it is wrong.
    """
    try:
        checked: SourceParams = _SOURCE.validate_json(json.dumps(source))
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(["source", *map(str, first["loc"][1:])])
        message = f"{where}: {first['msg'].removeprefix('Value error, ')}"
        raise ParamsError(message) from error
    return checked


def ask(look: Look, proposal: Proposal, wishes: Wishes, answer: Callable[[str], str]) -> Wishes:
    """Ask for what has to be said, field by field, and return the wishes with the answers.

    Args:
        look: what there is to choose from.
        proposal: what is not known.
        wishes: what was said before.
        answer: shows a question and returns the answer.
    """
    listed = "\n".join(f"{number:3}  {each.field}" for number, each in enumerate(look.fields, start=1))
    for unknown in proposal.unknown:
        if unknown == "rate":
            wishes = replace(wishes, rate_hz=_number(answer("Steps in a second (Hz)")))
            continue
        words = {"observation": "the state", "action": "the action"}[unknown]
        text = answer(f"{listed}\nWhich of them are {words}? Numbers or names, with commas between")
        fields = tuple(_field(look, each.strip()) for each in text.split(",") if each.strip())
        is_state = unknown == "observation"
        wishes = replace(wishes, observation=fields) if is_state else replace(wishes, action=fields)
    return wishes


def what_to_say(trial: Trial) -> str:
    """Return why nothing can be imported yet, and what has to be said, for an error."""
    if not trial.look.fields:
        why = next(iter(trial.look.unread.values()), "they are empty, or hold videos or images alone")
        return f"there is nothing in the files that could be imported ({why}); give others"
    missing = " and ".join(f"--{unknown}" for unknown in trial.proposal.unknown)
    return f"the files do not say it; give {missing}, with fields from this list"


def recorded_logs(found: Found) -> Recorded | None:
    """Return what is known of the files if all of them are logs of transitions, which need no import; else None.

    Raises:
        LogError: one of them is damaged.
    """
    if found.kind != "mcap":
        return None
    inspections = [inspect_file(file) for file in found.files]
    for each in inspections:
        if each.run is not None and each.problem is not None:
            message = f"{each.path}: {each.problem.message}"
            raise LogError(message)
    if not all(each.run is not None for each in inspections):
        return None
    with_episodes = [each for each in inspections if each.experience and len(each.experience.lengths)]
    return Recorded(
        [length for each in with_episodes if each.experience for length in each.experience.lengths],
        [each.path for each in with_episodes if each.run and each.run.environment == LEARNED],
    )


def predictions_words(predicted: Sequence[Path]) -> str:
    """Say that these logs hold predictions."""
    more = f" and {len(predicted) - 1} more logs" if len(predicted) > 1 else ""
    return (
        f"{predicted[0]}{more}: recorded in a learned model ({LEARNED}), that is what a model predicted and nothing "
        "that happened"
    )


def source_lines(proposal: Proposal) -> Iterator[str]:
    """Yield the section `source`, with what the files say beside each dimension."""
    yield "source: # 'addressed-dynamics source-keys' prints every key"
    for line in proposal.guessed:
        yield f"  # guessed {line}"
    for key, value in proposal.source.items():
        yield from _entry(key, value, "  ", proposal.notes)


def usable_lengths(assessment: Assessment) -> list[int]:
    """Return the steps of every episode that is worth training on."""
    return [each.samples - 1 for each in assessment.episodes if each.verdict != "leave"]


def section_text(name: str, origin: Iterable[str], lengths: Sequence[int], *, predictions: bool = False) -> str:
    """Return the section of a new experiment, as YAML.

    Args:
        name: the experiment.
        origin: lines that say where its transitions come from; none if its raw data are logs of transitions.
        lengths: steps of each of its episodes.
        predictions: whether some of its logs hold what a model predicted.
    """
    # As DVC's own writer has it, which then changes no more than what 'dvc exp run -S' asks for.
    yaml, stream = YAML(), io.StringIO()
    yaml.default_flow_style = False
    yaml.dump(yaml.load("\n".join(_section_lines(name, origin, lengths, predictions=predictions)) + "\n"), stream)
    return textwrap.indent(stream.getvalue(), "  ")


def _section_lines(name: str, origin: Iterable[str], lengths: Sequence[int], *, predictions: bool) -> Iterator[str]:
    yield f"title: {_scalar(name.replace('_', ' ').replace('-', ' ').capitalize())}"
    yield from ("paper:", "recipe: default", "paper_recipe: {}")
    yield from origin
    few = len(lengths) < FEW and max(lengths, default=0) > LONG
    convert = ["split: blocks"] if few else []
    if few and sum(lengths) < SHORT:
        convert.append("validation_share: 0.2")
    if predictions:
        convert.append("predictions: true")
    yield f"convert: {{{', '.join(convert)}}}{' # in time, for there are few episodes' if few else ''}"
    yield "features: {history: auto} # frames that a network is given: chosen on validation"
    if sum(lengths) < SMALL:
        yield f"ensemble: # for few and noisy data; 'addressed-dynamics params {name}' says what each key means"
        yield from (f"  {line}" for line in SMALL_ENSEMBLE)
        yield "addressing: {hidden: 64-64, epochs: 30}"
        yield "baselines: {addressing: {hidden: 64-64}}"
    else:
        yield from ("ensemble: {}", "addressing: {}", "baselines: {}")
    yield "evaluation: {deliver: best} # on validation data, never worse than nothing changing or least squares"
    yield "policy:"


def _entry(key: str, value: Any, indent: str, notes: Mapping[str, str]) -> Iterator[str]:
    """Yield a key: a mapping of scalars on one line, another one in a block."""
    note = f" # {notes[key]}" if isinstance(value, dict) and notes.get(key) else ""
    if isinstance(value, dict) and any(isinstance(each, dict | list) for each in value.values()):
        yield f"{indent}{_scalar(key)}:"
        for inner, each in value.items():
            yield from _entry(inner, each, indent + "  ", notes)
    elif isinstance(value, dict):
        inside = ", ".join(f"{_scalar(inner)}: {_scalar(each)}" for inner, each in value.items())
        yield f"{indent}{_scalar(key)}: {{{inside}}}{note}"
    elif isinstance(value, list):
        yield f"{indent}{_scalar(key)}:"
        yield from (f"{indent}- {_scalar(each)}" for each in value)
    else:
        yield f"{indent}{_scalar(key)}:" + ("" if value is None else f" {_scalar(value)}")


def yaml_text(text: str) -> str:
    """Return a text as YAML, with quotes only where it would be something else without them."""
    plain = _PLAIN.fullmatch(text) and YAML(typ="safe", pure=True).load(text) == text
    return text if plain else _scalar(text)


def _scalar(value: Any) -> str:
    """Return a value as YAML; the quotes of a text go where the writer does not need them."""
    return json.dumps(value) if not isinstance(value, str) else "'" + value.replace("'", "''") + "'"


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError as error:
        message = f"'{text}' is not a number"
        raise ParamsError(message) from error


def _field(look: Look, text: str) -> str:
    """Return the field of a number in the list that was shown, or what was written itself."""
    if text.isdecimal() and 1 <= int(text) <= len(look.fields):
        return look.fields[int(text) - 1].field
    return text
