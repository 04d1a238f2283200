"""All keys of an experiment's params, with their values and what they mean."""

import json
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.params.experiments import check_section, load_experiment, load_kind

WIDTH = 120
"""Columns of a line; what a key means stands above it."""


def params_lines(path: Path, experiment: str, kind: str | None) -> Iterator[str]:
    """Yield a YAML document with every key of `experiment`, defaults included, each below what it means.

    Raises:
        ParamsError: the file or the section is wrong, or no kind is given and the file does not name it.
    """
    known = kind or load_kind(path, experiment)
    if known is None:
        check_section(path, experiment)
        message = f"{path}: 'experiments' in it does not say of which kind '{experiment}' is; say it with --kind"
        raise ParamsError(message)
    yield f"{experiment}:"
    yield from _section(load_experiment(path, experiment, known), "  ")


def _section(section: BaseModel, indent: str) -> Iterator[str]:
    for name in type(section).model_fields:
        for line in textwrap.wrap(_meaning(type(section), name), WIDTH - len(indent) - 2):
            yield f"{indent}# {line}"
        yield from _entry(name, getattr(section, name), indent)


def _meaning(section: type[BaseModel], name: str) -> str:
    """Return what a key means; a section with other defaults leaves that to the one that it is made from."""
    sections = [parent for parent in section.mro() if issubclass(parent, BaseModel) and name in parent.model_fields]
    meanings = [parent.model_fields[name].description for parent in sections]
    return next((meaning for meaning in meanings if meaning), "")


def _entry(name: str, value: Any, indent: str) -> Iterator[str]:
    """Yield a key with its value, in which sections may be at any depth."""
    if isinstance(value, BaseModel):
        yield f"{indent}{name}:"
        yield from _section(value, f"{indent}  ")
    elif isinstance(value, dict) and any(isinstance(each, BaseModel) for each in value.values()):
        yield f"{indent}{name}:"
        for key, each in value.items():
            yield from _entry(key, each, f"{indent}  ")
    elif isinstance(value, tuple) and any(isinstance(each, BaseModel) for each in value):
        yield f"{indent}{name}:"
        for each in value:
            first, *rest = _section(each, f"{indent}  ")
            yield f"{indent}- {first.lstrip()}"
            yield from rest
    else:
        yield f"{indent}{name}: {json.dumps(value, ensure_ascii=False)}"
