"""Field paths: which number of which message, written as `/topic.field.sub[0]`.

A topic ends at the first dot; one with dots or brackets in its name stands in double quotes: `"/arm.v2".position[0]`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, TypeAlias

from google.protobuf.message import Message

from addressed_dynamics.base.errors import ParamsError

Step: TypeAlias = str | int
"""One step into a message: the name of a field, or the place in an array."""
MOST_LISTED = 40
"""Most fields that an error lists."""
DEEPEST_LISTED = 6
"""Fields further inside are not listed."""

_TOPIC = re.compile(r'"(?P<quoted>[^"]+)"|(?P<plain>[^".\[\]]+)')
_STEP = re.compile(r"\.(?P<name>[^.\[\]\"]+)|\[(?P<index>\d+)\]")
_PLACE = re.compile(r"(.+)\[(\d+)\]")
_SLICE = re.compile(r"\[(\d+):(\d+)\]")


@dataclass(frozen=True)
class FieldPath:
    """The way to one value."""

    topic: str
    steps: tuple[Step, ...]
    """The way from a message of the topic to the value."""

    def __str__(self) -> str:
        topic = f'"{self.topic}"' if re.search(r"[.\[\]]", self.topic) else self.topic
        return topic + shown(self.steps)


class MissingField(Exception):
    """A message does not have the field that a path leads to. Never leaves this package."""


def parse_path(text: str) -> FieldPath:
    """Read the path of one value.

    Raises:
        ParamsError: it is not a path; the message says at which character.
    """
    topic = _TOPIC.match(text)
    position = topic.end() if topic else 0
    steps: list[Step] = []
    while topic and position < len(text) and (step := _STEP.match(text, position)):
        steps.append(step["name"] if step["index"] is None else int(step["index"]))
        position = step.end()
    if topic is None or position < len(text) or not steps:
        message = (
            f"'{text}' is not the path of a field (see character {position + 1}); write /topic.field, "
            '/topic.field.sub[0] or, if the topic has dots in it, "/the.topic".field'
        )
        raise ParamsError(message)
    return FieldPath(topic["quoted"] or topic["plain"], tuple(steps))


def expand_slice(text: str) -> list[tuple[int | None, str]]:
    """Replace the slice in a path or column by each of its places: `p[0:2]` is (0, `p[0]`) and (1, `p[1]`).

    Without a slice it is itself, at no place.

    Raises:
        ParamsError: there are several slices, or it is empty.
    """
    slices = list(_SLICE.finditer(text))
    if not slices:
        return [(None, text)]
    first, last = int(slices[0][1]), int(slices[0][2])
    if len(slices) > 1 or first >= last:
        message = f"'{text}' should have one slice, with an end above its start, for instance [0:6]"
        raise ParamsError(message)
    before, after = text[: slices[0].start()], text[slices[0].end() :]
    return [(place, f"{before}[{place}]{after}") for place in range(first, last)]


def column_and_place(field: str) -> tuple[str, int | None]:
    """Split the name of a column from the place in its arrays: `state[2]` is (`state`, 2), `state` has no place."""
    match = _PLACE.fullmatch(field)
    return (field, None) if match is None else (match[1], int(match[2]))


def look_up(message: Any, steps: Sequence[Step], check_length: Callable[[tuple[Step, ...], int], None]) -> Any:
    """Return the value that `steps` lead to from a decoded message, None if it or what it is in was not set.

    Args:
        message: what a decoder returned.
        steps: the way.
        check_length: called for every array on the way, with the steps to it and its length.

    Raises:
        MissingField: there is no such field or place.
    """
    value = message
    for depth, step in enumerate(steps):
        if value is None:
            return None
        if isinstance(step, str):
            value = _member(value, step)
        else:
            if not _is_array(value):
                raise MissingField
            check_length(tuple(steps[:depth]), len(value))
            if step >= len(value):
                raise MissingField
            value = value[step]
    return value


def listed_fields(message: Any) -> str:
    """Name the fields of a decoded message, arrays as slices, for an error."""
    names = [shown(steps).lstrip(".") for steps in _leaves(message, ())]
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return (", ".join(names[:MOST_LISTED]) or "none") + more


def shown(steps: Sequence[Step | slice]) -> str:
    """Write steps as they are written in a path."""
    return "".join(_shown(step) for step in steps)


def _shown(step: Step | slice) -> str:
    match step:
        case str():
            return f".{step}"
        case slice():
            return f"[{step.start}:{step.stop}]"
        case _:
            return f"[{step}]"


def _leaves(value: Any, steps: tuple[Step | slice, ...]) -> Iterator[tuple[Step | slice, ...]]:
    names = _member_names(value)
    if len(steps) > DEEPEST_LISTED or not (names or _is_array(value)):
        yield steps
    elif names:
        for name in names:
            yield from _leaves(_member(value, name), (*steps, name))
    elif len(value) and (_member_names(value[0]) or _is_array(value[0])):
        yield from _leaves(value[0], (*steps, 0))
    else:
        yield (*steps, slice(0, len(value)))


def _member_names(value: Any) -> list[str]:
    match value:
        case Mapping():
            return [str(name) for name in value]
        case Message():
            return [field.name for field in value.DESCRIPTOR.fields]
        case SimpleNamespace():  # what mcap_ros2 decodes a message to; its fields are slots
            return list(getattr(type(value), "__slots__", ()))
        case _:
            return []


def _member(value: Any, name: str) -> Any:
    match value:
        case dict() if name in value:
            return value[name]
        case Message() if (field := value.DESCRIPTOR.fields_by_name.get(name)) is not None:
            # Protobuf gives 0 for what nobody set.
            return None if field.has_presence and not value.HasField(name) else getattr(value, name)
        case SimpleNamespace() if name in type(value).__slots__:  # type: ignore[attr-defined] # as in _member_names
            return getattr(value, name)
        case Mapping() if name in value:  # a map of protobuf
            return value[name]
        case _:
            raise MissingField


def _is_array(value: Any) -> bool:
    # Arrays come as lists, array.array, bytes and protobuf's containers, whose only common trait is this.
    return isinstance(value, Sequence | bytes) and not isinstance(value, str)
