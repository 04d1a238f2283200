"""Add an experiment to a params file and take it out again; all other lines stay as they are."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from addressed_dynamics.base.errors import ParamsError
from addressed_dynamics.base.files import atomic_path
from addressed_dynamics.base.params.experiments import parse_params

MARK = "# made by 'addressed-dynamics new'"
"""Stands beside the name of a section that may be removed without asking."""
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
"""What an experiment may be called: its name is part of the names of folders and stages."""


def add_experiment(path: Path, name: str, entries: Mapping[str, str], section: str) -> None:
    """Write the section of a new experiment at the end of a params file, and its name into mappings at the top.

    Args:
        path: the params file.
        name: the experiment.
        entries: what its name stands for in each mapping, as YAML: `experiments`, `imported`.
        section: its section, as YAML, indented by two blanks.

    Raises:
        ParamsError: the name is no name or is taken, the file cannot be read or written, or a mapping is written in
            a form that cannot be added to; the file is then as it was.
    """
    text, crlf = _text(path)
    before = parse_params(path, text)
    _check_free(path, before, name, entries)
    lines = text.rstrip("\n").split("\n")
    for mapping, value in entries.items():
        _insert(path, lines, mapping, f"{name}: {value}")
    body = "\n".join([*lines, "", f"{name}: {MARK}", section.rstrip("\n")]) + "\n"
    after = parse_params(path, body)
    expected = {**before, **{mapping: {**(before.get(mapping) or {}), name: YAML(typ="safe").load(value)}
                             for mapping, value in entries.items()}}  # fmt: skip
    _check(path, {key: value for key, value in after.items() if key != name}, expected)
    _write(path, body, crlf=crlf)


def check_free(path: Path, name: str, mappings: Iterable[str]) -> None:
    """Refuse a name that `add_experiment` would refuse, before there is anything to add.

    Raises:
        ParamsError: the name is no name or is taken, or the file cannot be read.
    """
    _check_free(path, parse_params(path, _text(path)[0]), name, mappings)


def _check_free(path: Path, before: Mapping[str, Any], name: str, mappings: Iterable[str]) -> None:
    if not NAME.fullmatch(name):
        message = f"'{name}' cannot be the name of an experiment; give letters, digits, - and _, a letter first"
        raise ParamsError(message)
    named = any(name in _entries(path, before, mapping) for mapping in mappings)
    if name in before or named:
        undo = f", or 'addressed-dynamics remove {name}'" if named else ""
        message = f"{path}: there is a '{name}' in it already; give another name{undo}"
        raise ParamsError(message)


def _entries(path: Path, before: Mapping[str, Any], mapping: str) -> Mapping[str, Any]:
    entries = before.get(mapping) or {}
    if not isinstance(entries, Mapping):
        message = f"{path}: '{mapping}' in it is not a mapping with a line for each entry; mend it by hand"
        raise ParamsError(message)
    return entries


def remove_experiment(path: Path, name: str, mappings: tuple[str, ...], *, of_anybody: bool = False) -> None:
    """Take out what `add_experiment` wrote; the file is then as it was before, if nobody has changed it since.

    Args:
        path: the params file.
        name: the experiment.
        mappings: the mappings at the top that may name it.
        of_anybody: whether a section without the mark may go, which somebody has written.

    Raises:
        ParamsError: there is no such section, it has no mark, or the file cannot be read or written.
    """
    text, crlf = _text(path)
    before = parse_params(path, text)
    lines = text.split("\n")
    start = next((place for place, line in enumerate(lines) if re.match(rf"{re.escape(name)}\s*:", line)), None)
    named = any(name in _entries(path, before, mapping) for mapping in mappings)
    if start is None or not (named or MARK in lines[start]):
        message = f"{path}: there is no experiment '{name}' in it"
        raise ParamsError(message)
    if MARK not in lines[start] and not of_anybody:
        message = f"{path}: '{name}' was not made by 'addressed-dynamics new'; to remove it all the same, add --yes"
        raise ParamsError(message)
    stop = _end(lines, start)
    # The empty line before a section belongs to it.
    first = start - 1 if start and not lines[start - 1] else start
    del lines[first:stop]
    for mapping in mappings:
        _delete(lines, mapping, name)
    body = "\n".join(lines)
    expected = {key: {each: entry for each, entry in value.items() if each != name} if key in mappings else value
                for key, value in before.items() if key != name}  # fmt: skip
    _check(path, parse_params(path, body), expected)
    _write(path, body, crlf=crlf)


def _text(path: Path) -> tuple[str, bool]:
    """Return what is in a file, with the line ends of Unix, and whether it has those of Windows throughout."""
    try:
        text = path.read_bytes().decode()
    except (OSError, UnicodeDecodeError) as error:
        message = f"{path}: the params file cannot be read ({error})"
        raise ParamsError(message) from error
    crlf = text.count("\r\n") == text.count("\n") > 0
    return (text.replace("\r\n", "\n") if crlf else text), crlf


def _write(path: Path, text: str, *, crlf: bool) -> None:
    """Replace what is in a file, through a link to it, and let it be as readable and writable as it was."""
    try:
        if not os.access(path, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        with atomic_path(path.resolve()) as temporary:
            temporary.write_bytes((text.replace("\n", "\r\n") if crlf else text).encode())
            shutil.copymode(path, temporary)
    except OSError as error:
        message = f"{path}: the params file cannot be written ({error.strerror}); nothing was changed"
        raise ParamsError(message) from error


def _head(lines: list[str], mapping: str) -> tuple[int, re.Match[str]] | None:
    """Return the line of a mapping at the top, taken apart: its key, its value if that is there, too, a comment."""
    for place, line in enumerate(lines):
        match = re.fullmatch(rf"({re.escape(mapping)}:)(?: +(\{{[^#]*\}}))?( *#.*)? *", line)
        if match:
            return place, match
    return None


def _block(lines: list[str], place: int) -> range:
    """Return the lines below a key that are part of its value."""
    stop = place + 1
    while stop < len(lines) and lines[stop].startswith(" "):
        stop += 1
    return range(place + 1, stop)


def _end(lines: list[str], start: int) -> int:
    """Return where the section ends whose name stands at `start`; comments and empty lines behind it are not part."""
    last = start
    for place in range(start + 1, len(lines)):
        if lines[place].startswith((" ", "-")):
            last = place
        elif lines[place] and not lines[place].startswith("#"):
            break
    return last + 1


def _insert(path: Path, lines: list[str], mapping: str, entry: str) -> None:
    found = _head(lines, mapping)
    if found is None:
        message = f"{path}: '{mapping}' in it is not a mapping with a line for each entry; add '{entry}' to it by hand"
        raise ParamsError(message)
    place, match = found
    key, flow, comment = match[1], (match[2] or "{}")[1:-1].strip(), match[3] or ""
    if flow:
        lines[place] = f"{key} {{{flow}, {entry}}}{comment}"
        return
    lines[place] = f"{key}{comment}"
    lines.insert(_block(lines, place).stop, f"  {entry}")


def _delete(lines: list[str], mapping: str, name: str) -> None:
    found = _head(lines, mapping)
    if found is None:
        return
    place, match = found
    key, flow, comment = match[1], match[2], match[3] or ""
    if flow:
        entry = rf"{re.escape(name)}:\s*(?:\{{[^{{}}]*\}}|[^,{{}}]*)"
        inner = re.sub(rf"(,\s*{entry}(?=\s*[,}}])|(?<=\{{){entry}(?:,\s*)?)", "", flow)
        lines[place] = f"{key} {inner}{comment}"
        return
    for row in _block(lines, place):
        if re.match(rf"\s+{re.escape(name)}\s*:", lines[row]):
            del lines[row]
            break
    if not _block(lines, place):
        lines[place] = f"{key} {{}}{comment}"


def _check(path: Path, found: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    if {key: value or {} for key, value in found.items()} != {key: value or {} for key, value in expected.items()}:
        message = f"{path}: it is written in a form that cannot be changed without a loss; change it by hand"
        raise ParamsError(message)
