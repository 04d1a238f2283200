"""The params file as frozen, checked models: an unknown key, a missing key or a wrong type is a one-line error."""

from __future__ import annotations

import json
import os
import reprlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.kinds import supplied
from addressed_dynamics.base.params.sections import CHOOSERS, merged
from addressed_dynamics.base.params.source import EXAMPLES, SourceParams
from addressed_dynamics.base.params.training import AddressingTraining

_FORMS = {"int", "tuple[float, ...]"}
"""What pydantic adds to a key's path where a value may be of several types."""
_LISTS = {"experiments", "recorded", "imported"}
"""Mappings at the top of a params file that are no experiments."""
PARAMS = Path("params.yaml")
"""The params file of the project that one is in."""
EXTENDS = "extends"
"""Key at the top of a params file with the name of another, relative to its folder, which it takes the place of where
it says otherwise."""


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
    section = _section(path, experiment, _read_params(path))
    return _load_recipes(path, experiment, section, supplied("sources", kind, "params").FORM)


def check_section(path: Path, experiment: str) -> None:
    """Check that the params file at `path` has a section of `experiment`.

    Raises:
        ParamsError: it has none, or the file is missing or is not YAML; the message names those that it has.
    """
    _section(path, experiment, _read_params(path))


def experiment_names(path: Path) -> list[str]:
    """Return the experiments that the pipeline runs with the params file at `path`, in its order.

    Raises:
        ParamsError: the file, or one that it extends, is missing or is not YAML.
    """
    entries = _read_params(path).get("experiments")
    return list(map(str, entries)) if isinstance(entries, dict) else []


def known_experiments(path: Path = PARAMS) -> list[str]:
    """Return what `experiment_names` does; nothing if the file is not there or cannot be read."""
    try:
        return experiment_names(path) if path.is_file() else []
    except ParamsError:
        return []


def load_kind(path: Path, experiment: str) -> str | None:
    """Return the kind of data that the params file at `path`, or one that it extends, names for `experiment`, if any.

    Raises:
        ParamsError: a file is missing or is not YAML.
    """
    document = _read_params(path)
    for names, key in (("experiments", "kind"), ("recorded", None)):
        entry = (document.get(names) or {}).get(experiment)
        kind = entry.get(key) if isinstance(entry, dict) else entry
        if isinstance(kind, str):
            return kind
    return "transitions" if "source" in (document.get(experiment) or {}) else None


def replaced_keys(path: Path, experiment: str) -> list[str]:
    """Return what the params file at `path` takes the place of in the file that it extends, as `key: old -> new`.

    Raises:
        ParamsError: as in `load_experiment`.
    """
    document = _read_yaml(path)
    if EXTENDS not in document:
        return []
    base = _read_params(_extended(path, document))
    return [*_differences(base.get(experiment), _section(path, experiment, document))]


def load_record_params(path: Path, experiment: str, kind: str) -> Any:
    """Read the recording plan of `experiment`.

    Raises:
        ParamsError: as in `load_experiment`, or there is nothing to record.
    """
    plan = load_experiment(path, experiment, kind).record
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


def _load_recipes(path: Path, experiment: str, section: Any, form: Any) -> tuple[Any, Any]:
    default = _validated(path, experiment, section, form)
    changes = merged(default.paper_recipe.PAPER, default.paper_recipe.model_dump(mode="json"))
    training = {key: value for key, value in changes["addressing"].items() if key in AddressingTraining.model_fields}
    paper = _validated(path, experiment, merged(section, changes | {"baselines": {"addressing": training}}), form)
    return (default, paper) if default.recipe == "default" else (paper, default)


def _read_params(path: Path, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a params file with what it extends, which it takes the place of key by key."""
    document = _read_yaml(path)
    if EXTENDS not in document:
        return document
    base = _extended(path, document)
    if base.resolve() in above:
        message = f"{path}: it extends {base}, which extends it in turn; take '{EXTENDS}' out of one of them"
        raise ParamsError(message)
    return merged(_read_params(base, (*above, path.resolve())), document)


def _extended(path: Path, document: dict[str, Any]) -> Path:
    name = document[EXTENDS]
    if not isinstance(name, str):
        message = f"{path}: {EXTENDS}: it should be the name of a params file, but is {reprlib.repr(name)}"
        raise ParamsError(message)
    base = Path(os.path.normpath(path.parent / name))
    if not base.is_file():
        message = (
            f"{path}: {EXTENDS}: there is no params file {base}; the name is relative to the folder of {path.name}"
        )
        raise ParamsError(message)
    return base


def _differences(below: Any, above: Any, key: str = "") -> Iterator[str]:
    if isinstance(below, dict) and isinstance(above, dict):
        for name in above:
            if name in below:
                yield from _differences(below[name], above[name], f"{key}.{name}" if key else name)
    elif below != above:
        yield f"{key}: {reprlib.repr(below)} -> {reprlib.repr(above)}"


def _section(path: Path, experiment: str, document: dict[str, Any]) -> Any:
    _refuse_old_form(path, experiment, document)
    if experiment not in document:
        sections = [name for name in document if isinstance(document[name], dict) and name not in _LISTS]
        known = ", ".join(map(str, sections)) or "none"
        message = f"{path}: there is no experiment '{experiment}' in it (experiments there: {known})"
        raise ParamsError(message)
    return document[experiment]


def _refuse_old_form(path: Path, experiment: str, document: dict[str, Any]) -> None:
    section = document.get(experiment)
    old = sorted({"motions", "made_up"} & set(document))
    if isinstance(section, dict):
        old += [f"{experiment}.{key}" for key in ("walker", "kind", "augmentation") if key in section]
        parts = ("ensemble", "addressing", "baselines")
        old += [f"{experiment}.{key}.processes" for key in parts if "processes" in (section.get(key) or {})]
    if old or isinstance(document.get("experiments"), list):
        found = ", ".join(old or ["a list under 'experiments'"])
        message = (
            f"{path}: a params file of an earlier form ({found}): 'experiments' is now a mapping of names to "
            "{kind: transitions or motion, raw: folder of the raw data}, 'recorded' one of names to kinds, 'motions' "
            "and 'made_up' are gone, and in a section 'walker' is 'record', 'augmentation' belongs in "
            "'features', 'kind' and 'processes' are left out"
        )
        raise ParamsError(message)


def _validated(path: Path, experiment: str, section: Any, form: Any) -> Any:
    try:
        return form.model_validate_json(json.dumps(section))
    except ValidationError as error:
        raise ParamsError(_one_line(path, experiment, section, error)) from error
    except TypeError as error:
        message = f"{path}: the section '{experiment}' has a value of a kind that params cannot hold ({error})"
        raise ParamsError(message) from error


def _read_yaml(path: Path) -> dict[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError as error:
        message = f"{path}: no such params file"
        raise ParamsError(message) from error
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the params file cannot be read ({error})"
        raise ParamsError(message) from error
    return parse_params(path, text)


def parse_params(path: Path, text: str) -> dict[str, Any]:
    """Return what the text of a params file says.

    Raises:
        ParamsError: it is not YAML, or no mapping of sections; the message names `path`.
    """
    try:
        document = YAML(typ="safe", pure=True).load(text)
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
    if first["type"] == "missing" and first["loc"][0] == "source":
        missing = [each["loc"] for each in problems if each["type"] == "missing" and each["loc"][0] == "source"]
        return _missing_in_source(path, experiment, section, missing)
    # A key that is missing may be called as a form is.
    ends = first["loc"][-1:] if first["type"] == "missing" else ()
    within = first["loc"][: len(first["loc"]) - len(ends)]
    where = ".".join([experiment, *_key_path(within, section), *map(str, ends)])
    match first["type"]:
        case "extra_forbidden":
            what = "unknown key; check its spelling, or remove it"
        case "missing":
            what = "missing key"
        case "union_tag_not_found":
            what = f"missing key {first['ctx']['discriminator']}, which says what the others mean"
        case "value_error":
            what = first["msg"].removeprefix("Value error, ")
        case "tuple_type":
            what = f"it should be a list, but it is {reprlib.repr(first['input'])}"
        case _:
            what = f"{first['msg'][0].lower()}{first['msg'][1:]}, but it is {reprlib.repr(first['input'])}"
    more = f" (and {len(problems) - 1} more)" if len(problems) > 1 else ""
    return f"{path}: {where}: {what}{more}"


def _missing_in_source(path: Path, experiment: str, section: Any, missing: list[tuple[int | str, ...]]) -> str:
    """Name all keys that a source lacks, with an example of its kind."""
    names = [".".join(_key_path(location, section)[1:]) for location in missing]
    kind = section["source"]["kind"]
    what = f"{names[0]}: missing key" if len(names) == 1 else f"missing keys: {', '.join(names)}"
    joint = "." if len(names) == 1 else ": "
    return f"{path}: {experiment}.source{joint}{what}; for example {{kind: {kind}, {EXAMPLES[kind]}}}"


def _key_path(location: tuple[int | str, ...], section: Any) -> list[str]:
    """Return the path of a key as it is in the file, without what pydantic adds to it."""
    keys: list[str] = []
    place, chosen = section, False
    for index, part in enumerate(location):
        if part in _FORMS:
            continue
        # pydantic adds the form that was chosen.
        if not chosen and _is_form(place, location[index : index + 2]):
            chosen = True
            continue
        if isinstance(place, dict) and isinstance(part, int) and part not in place and part < len(place):
            part = list(place)[part]
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


def _is_form(place: Any, parts: tuple[int | str, ...]) -> bool:
    """Whether the first of the next two parts of a location is the form that the section at `place` chose.

    A key may be called as a form is: after a form comes a key of the section, after a key something below it.
    """
    if not isinstance(place, dict) or parts[0] not in [place.get(key) for key in CHOOSERS]:
        return False
    return parts[0] not in place or any(part in place for part in parts[1:])
