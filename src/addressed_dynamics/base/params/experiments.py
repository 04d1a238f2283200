"""The params file as frozen, checked models: an unknown key, a missing key or a wrong type is a one-line error."""

from __future__ import annotations

import json
import reprlib
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import Field, ValidationError, model_validator
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.motion import MotionExperimentParams, WalkerParams
from addressed_dynamics.base.params.recording import EnvironmentParams, RecordParams
from addressed_dynamics.base.params.sections import Count, Positive, Section, Seed, Share
from addressed_dynamics.base.params.source import SourceParams
from addressed_dynamics.base.params.training import (
    AddressingParams,
    AddressingTraining,
    BaselinesParams,
    EnsembleParams,
    RecipeChanges,
)


class ConvertParams(Section):
    """From logs to tables."""

    validation_share: Share
    """Share of the episodes kept for choosing recipes."""
    test_share: Share
    """Share of the episodes kept for the evaluation."""
    split_seed: Seed
    """Seed of the hash that gives each episode its split."""
    row_group_rows: Count
    """Rows in a Parquet row group."""

    @model_validator(mode="after")
    def _leaves_training_data(self) -> ConvertParams:
        if self.validation_share + self.test_share >= 1.0:
            message = "validation_share + test_share must be below 1, or nothing is left to train on"
            raise ValueError(message)
        return self


class AngleParams(Section):
    """An angle that the observation gives by its cosine and its sine."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z_][A-Za-z0-9_]*$")]
    cosine: str
    """Name of the dimension with its cosine."""
    sine: str
    """Name of the dimension with its sine."""
    velocity: str | None = None
    """Name of the dimension with its velocity, in rad/s, if there is one."""


class FeatureParams(Section):
    """What a network is given and what it is asked for."""

    target: Literal["absolute", "change"]
    """`absolute`: the next state, as in the paper; `change`: the next state minus the state."""
    history: Count = 1
    """Number of consecutive frames (states with their actions) that a network is given."""
    history_weight: Positive = 1.0
    """Size of the inputs of older frames beside those of the last, which is the state itself; 1 makes no difference
    between them, as in the paper."""
    angles: tuple[AngleParams, ...] = ()
    """Angles given by cosine and sine; predicted cosines and sines are put back on the unit circle."""
    angle_from: Literal["weighted", "atan2"] = "atan2"
    """How an angle comes from a predicted cosine and sine: the paper's weighted mean (Section 3.3), or atan2."""
    velocity: Literal["difference", "predicted"] = "predicted"
    """Where the angles' velocities come from: differences of successive angles, as in the paper, or the network."""


class EnvironmentRollouts(Section):
    """Free-running rollouts beside an environment that acts under a behaviour no model has seen."""

    kind: Literal["environment"]
    environment: EnvironmentParams
    episodes: Count
    steps: Count
    seed: Seed
    swing_share: Share
    """Largest share of stretches in which the behaviour pushes in the direction of motion, which drives a car to both
    walls; in the others it holds a random action."""
    mean_hold_steps: Annotated[float, Field(ge=1.0)]
    """Mean length of a stretch, in steps (geometric)."""


class RecordedRollouts(Section):
    """Free-running rollouts beside stretches of held-out episodes, under the actions recorded there."""

    kind: Literal["recorded"]
    episodes: Count
    """Stretches to replay; fewer if the held-out episodes have no more."""
    steps: Annotated[int, Field(ge=2)]
    """Steps in a stretch; if no held-out episode is as long, as many as the longest allows."""
    seed: Seed
    """Which stretches are taken, if there are more than asked for."""
    physics: Literal["acrobot"] | None = None
    """`acrobot`: judge angles and energy too, beside simulations by the true equations of motion."""
    apart: Positive = 1e-6
    """How far the first angles of two true simulations are apart at the start, in rad, to show what is possible."""


class EvaluationParams(Section):
    """What is measured on held-out episodes."""

    rollouts: Annotated[EnvironmentRollouts | RecordedRollouts, Field(discriminator="kind")]


class ExperimentParams(Section):
    """All sections of one experiment; its transitions are either recorded or imported."""

    title: str
    recipe: Literal["default", "paper"] = "default"
    """Whether the sections below hold as they are, or with what `paper_recipe` changes."""
    paper_recipe: RecipeChanges = Field(default_factory=RecipeChanges)
    """What the paper does otherwise; its addressing holds for `baselines.addressing` too."""
    record: RecordParams | None = None
    """What to record; absent if there is a `source`."""
    source: SourceParams | None = None
    """Which logs or tables to import; absent if there is a `record`."""
    convert: ConvertParams
    features: FeatureParams
    ensemble: EnsembleParams
    addressing: AddressingParams
    baselines: BaselinesParams
    evaluation: EvaluationParams

    @model_validator(mode="after")
    def _has_one_origin(self) -> ExperimentParams:
        if (self.record is None) == (self.source is None):
            found = "neither" if self.record is None else "both"
            message = f"an experiment has either 'record' or 'source', but this one has {found}"
            raise ValueError(message)
        return self


_FORMS = {"int", "tuple[float, ...]"}
"""What pydantic adds to a key's path where a value may be of several types."""
_LISTS = {"experiments", "imported"}
"""Mappings at the top of a params file that are no experiments."""
_CHOOSERS = ("kind", "by")
"""Keys whose value chooses one of several forms of their section; pydantic adds this value to the path."""


_FORMS_OF_KINDS: dict[str, Any] = {
    "transitions": ExperimentParams,
    "motion": MotionExperimentParams,
}


def load_experiment(path: Path, experiment: str, kind: str) -> Any:
    """Read the section of `experiment`, of a kind of data, from the params file at `path`, with the recipe it asks for.

    Raises:
        ParamsError: the file is missing or is not YAML, the experiment is not in it, there is no such kind, or a key in
            its section is unknown, missing or of a wrong type; the message gives the key's path.
    """
    return load_recipes(path, experiment, kind)[0]


def load_recipes(path: Path, experiment: str, kind: str) -> tuple[Any, Any]:
    """Read the section of `experiment` as `load_experiment` does, with the recipe asked for and with the other.

    Raises:
        ParamsError: as in `load_experiment`.
    """
    if kind not in _FORMS_OF_KINDS:
        message = f"{path}: {experiment}: there is no kind of data '{kind}' (kinds: {', '.join(_FORMS_OF_KINDS)})"
        raise ParamsError(message)
    return _load_recipes(path, experiment, _read_section(path, experiment), _FORMS_OF_KINDS[kind])


def load_record_params(path: Path, experiment: str, kind: str) -> RecordParams | WalkerParams:
    """Read the recording plan of `experiment`.

    Raises:
        ParamsError: as in `load_experiment`, or there is nothing to record.
    """
    plan: RecordParams | WalkerParams | None = load_experiment(path, experiment, kind).record
    if plan is None:
        message = (
            f"{path}: {experiment}: there is nothing to record, because it has no 'record'; "
            "take it out of 'recorded' in params.yaml, or give it one"
        )
        raise ParamsError(message)
    return plan


def load_source_params(path: Path, experiment: str, kind: str) -> SourceParams:
    """Read what `experiment` imports.

    Raises:
        ParamsError: as in `load_experiment`, or there is nothing to import.
    """
    source: SourceParams | None = getattr(load_experiment(path, experiment, kind), "source", None)
    if source is None:
        message = (
            f"{path}: {experiment}: there is nothing to import, because it has no 'source'; "
            "take it out of 'imported' in params.yaml, or give it one"
        )
        raise ParamsError(message)
    return source


_Form = TypeVar("_Form", ExperimentParams, MotionExperimentParams)


def _load_recipes(path: Path, experiment: str, section: Any, form: type[_Form]) -> tuple[_Form, _Form]:
    default = _validated(path, experiment, section, form)
    changes = default.paper_recipe
    changed = {**section, **{name: {**section.get(name, {}), **keys} for name, keys in changes}}
    training = {key: value for key, value in changes.addressing.items() if key in AddressingTraining.model_fields}
    baselines = section["baselines"]
    changed["baselines"] = {**baselines, "addressing": {**baselines["addressing"], **training}}
    paper = _validated(path, experiment, changed, form)
    return (default, paper) if default.recipe == "default" else (paper, default)


def _read_section(path: Path, experiment: str) -> Any:
    document = _read_yaml(path)
    if experiment not in document:
        sections = [name for name in document if isinstance(document[name], dict) and name not in _LISTS]
        known = ", ".join(map(str, sections)) or "none"
        message = f"{path}: there is no experiment '{experiment}' in it (experiments there: {known})"
        raise ParamsError(message)
    return document[experiment]


def _validated(path: Path, experiment: str, section: Any, form: type[_Form]) -> _Form:
    try:
        return form.model_validate_json(json.dumps(section))
    except ValidationError as error:
        raise ParamsError(_one_line(path, experiment, section, error)) from error
    except TypeError as error:
        message = f"{path}: the section '{experiment}' has a value of a kind that params cannot hold ({error})"
        raise ParamsError(message) from error


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        document = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        message = f"{path}: no such params file"
        raise ParamsError(message) from error
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the params file cannot be read ({error})"
        raise ParamsError(message) from error
    except YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = f", line {mark.line + 1}" if mark is not None else ""
        problem = str(getattr(error, "problem", None) or error).split("\n", maxsplit=1)[0]
        message = f"{path}{where}: not a YAML file ({problem})"
        raise ParamsError(message) from error
    if not isinstance(document, dict):
        message = f"{path}: a params file is a mapping of sections, but this one holds {type(document).__name__}"
        raise ParamsError(message)
    return document


def _one_line(path: Path, experiment: str, section: Any, error: ValidationError) -> str:
    problems = error.errors()
    first = problems[0]
    where = ".".join([experiment, *_key_path(first["loc"], section)])
    match first["type"]:
        case "extra_forbidden":
            what = "unknown key; check its spelling, or remove it"
        case "missing":
            what = "missing key"
        case "value_error":
            what = first["msg"].removeprefix("Value error, ")
        case _:
            what = f"{first['msg'][0].lower()}{first['msg'][1:]}, but it is {reprlib.repr(first['input'])}"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{path}: {where}: {what}{more}"


def _key_path(location: tuple[int | str, ...], section: Any) -> list[str]:
    """Return the path of a key as it is in the file, without what pydantic adds to it."""
    keys: list[str] = []
    place, chosen = section, False
    for part in location:
        if part in _FORMS:
            continue
        if isinstance(place, dict) and not chosen and part in [place.get(key) for key in _CHOOSERS]:
            chosen = True
            continue
        keys.append(str(part))
        chosen = False
        match place:
            case dict():
                place = place.get(part)
            case list() if isinstance(part, int) and part < len(place):
                place = place[part]
            case _:
                place = None
    return keys
