"""Field paths: which number of which message, written as `/topic.field.sub[0]`.

A topic ends at the first dot; a topic or field with dots or brackets in its name stands in double quotes:
`"/arm.v2".position[0]`, `/state."pos.x"`. Where names stand beside an array, `position[elbow]` is the element that has
this name; one that does not begin with a letter stands in quotes, too: `position["2nd joint"]`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import MISSING, dataclass, fields, is_dataclass
from functools import lru_cache
from keyword import iskeyword
from typing import Any, TypeAlias

import numpy as np
from google.protobuf.message import Message

from addressed_dynamics.base.errors import ParamsError


@dataclass(frozen=True)
class Label:
    """A step into an array: to the element that has this name."""

    name: str


Step: TypeAlias = str | int | Label
"""One step into a message: the name of a field, or the place in an array or its name."""
MOST_LISTED = 40
"""Most fields that an error lists."""
DEEPEST_LISTED = 6
"""Fields further inside are not listed."""

_TOPIC = re.compile(r'"(?P<quoted>[^"]+)"|(?P<plain>[^".\[\]]+)')
_STEP = re.compile(
    r"""\.(?:"(?P<quoted>[^"]+)"|(?P<name>[^.\[\]"]+))  # a field
    |\[(?P<index>\d+)\]
    |\[(?:"(?P<label>[^"]+)"|(?P<word>[^\W\d][^"\[\]]*))\]""",
    re.VERBOSE,
)
_WORD = re.compile(r"[^\W\d][^\"\[\]]*")
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
        steps.append(_step(step))
        position = step.end()
    if topic is None or position < len(text) or not steps:
        message = (
            f"'{text}' is not the path of a field (see character {position + 1}); write /topic.field, "
            '/topic.field.sub[0] or, if a name has dots in it, "/the.topic"."the.field"'
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


def look_up(
    message: Any, steps: Sequence[Step], place: Callable[[Sequence[Step], Sequence[Any], Any, int | Label], int | None]
) -> Any:
    """Return the value that `steps` lead to from a decoded message, None if it or what it is in was not set.

    Args:
        message: what a decoder returned.
        steps: the way.
        place: called for every array on the way, with the steps to it, what it is in (the message first), the array and
            the step into it; returns the place of the element, None if it has no value there.

    Raises:
        MissingField: there is no such field or place.
    """
    value, containers = message, [message]
    for depth, step in enumerate(steps):
        if value is None:
            return None
        if isinstance(step, str):
            value = member(value, step)
        else:
            if not is_array(value):
                raise MissingField
            index = place(steps[:depth], containers, value, step)
            if index is None:
                return None
            if index >= len(value):
                raise MissingField
            value = value[index]
        containers.append(value)
    return value


def listed_fields(message: Any) -> str:
    """Name the fields of a decoded message, arrays as slices, for an error."""
    names = [shown(steps).lstrip(".") for steps in _leaves(message, ())]
    more = f" and {len(names) - MOST_LISTED} more" if len(names) > MOST_LISTED else ""
    return (", ".join(names[:MOST_LISTED]) or "none") + more


def shown(steps: Sequence[Step | slice]) -> str:
    """Write steps as they are written in a path."""
    return "".join(_shown(step) for step in steps)


def member(value: Any, name: str) -> Any:
    """Return the field `name` of a decoded message or of a part of it, None if it was not set.

    Raises:
        MissingField: there is no such field.
    """
    if isinstance(value, dict | Mapping):  # a map of protobuf is no dict
        if name not in value:
            raise MissingField
        return value[name]
    if isinstance(value, Message):
        field = value.DESCRIPTOR.fields_by_name.get(name)
        if field is None:
            raise MissingField
        # Protobuf gives 0 for what nobody set.
        return None if field.has_presence and not value.HasField(name) else getattr(value, name)
    if name not in _attributes(type(value)):
        raise MissingField
    return getattr(value, _attributes(type(value))[name])


def is_array(value: Any) -> bool:
    """Say whether a value is an array: a list, bytes, a container of protobuf or an array of NumPy."""
    return isinstance(value, np.ndarray | Sequence | bytes) and not isinstance(value, str)


def _find_attributes(kind: type) -> dict[str, str]:
    """Return the attributes of a decoded ROS 2 message by the names of its fields; none of anything else.

    A field whose name is a word of Python has an underscore behind it there.
    """
    if not is_dataclass(kind):
        return {}
    # Constants of a type have a value there; they are in no message.
    names = [each.name for each in fields(kind) if each.default is MISSING]
    return {name[:-1] if name.endswith("_") and iskeyword(name[:-1]) else name: name for name in names}


_attributes: Callable[[type], dict[str, str]] = lru_cache(maxsize=1024)(_find_attributes)


def _step(match: re.Match[str]) -> Step:
    if match["index"] is not None:
        return int(match["index"])
    label = match["label"] or match["word"]
    return str(match["quoted"] or match["name"]) if label is None else Label(label)


def _shown(step: Step | slice) -> str:
    match step:
        case str():
            return f'."{step}"' if re.search(r"[.\[\]]", step) else f".{step}"
        case Label(name):
            return f"[{name}]" if _WORD.fullmatch(name) else f'["{name}"]'
        case slice():
            return f"[{step.start}:{step.stop}]"
        case _:
            return f"[{step}]"


def _leaves(value: Any, steps: tuple[Step | slice, ...]) -> Iterator[tuple[Step | slice, ...]]:
    names = member_names(value)
    if len(steps) > DEEPEST_LISTED or not (names or is_array(value)):
        yield steps
    elif names:
        for name in names:
            yield from _leaves(member(value, name), (*steps, name))
    elif len(value) and (member_names(value[0]) or is_array(value[0])):
        yield from _leaves(value[0], (*steps, 0))
    else:
        yield (*steps, slice(0, len(value)))


def member_names(value: Any) -> list[str]:
    """Return the names of the fields of a decoded message or of a part of it; none of what is no message."""
    match value:
        case Mapping():
            return [str(name) for name in value]
        case Message():
            return [field.name for field in value.DESCRIPTOR.fields]
        case _:
            return list(_attributes(type(value)))
