"""The protobuf messages of a log, generated from the spaces of an environment.

`addressed_dynamics.Transition` has the named dimensions as scalar fields of its sub-messages, so that a viewer offers
`observation.position`; exogenous inputs are its last field, which is there only if there are any.
`addressed_dynamics.Episode` tells how an episode ended. Only field types whose encoding has a fixed length are used
(`layout.py` relies on it).
"""

import re
from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from google.protobuf.descriptor_pb2 import (
    DescriptorProto,
    EnumDescriptorProto,
    FieldDescriptorProto,
    FileDescriptorProto,
    FileDescriptorSet,
)

from addressed_dynamics.base.errors import SpaceError
from addressed_dynamics.episodes.transitions import ContinuousAction, Dimension, SpaceSpec
from addressed_dynamics.logs.contents import Ended
from addressed_dynamics.logs.layout import MessageLayout, message_layout

PACKAGE = "addressed_dynamics"
TRANSITION_SCHEMA = f"{PACKAGE}.Transition"
EPISODE_SCHEMA = f"{PACKAGE}.Episode"

ENDED: tuple[Ended, ...] = ("cut", "terminated", "truncated")
"""The values of the field `ended` of an episode, by number."""

UNKNOWN_SEED = -1
"""The field `seed` of an episode whose seed is not known."""

MOST_DIMENSIONS = 10_000
"""Most dimensions of an observation, an action or the exogenous inputs; protobuf decoders refuse messages of over some
16,000 fields."""

_IDENTIFIER = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_Field = FieldDescriptorProto


def transition_file(spec: SpaceSpec) -> FileDescriptorProto:
    """Return the protobuf file whose only message is the transition of an environment with these spaces.

    Raises:
        SpaceError: a dimension has a name that protobuf cannot hold, two have the same, or there are none or too many.
    """
    message = DescriptorProto(name="Transition")
    message.nested_type.append(_vector_message("Observation", spec.observation_names))
    _add_field(message, "episode", _Field.TYPE_SFIXED64)
    _add_field(message, "step", _Field.TYPE_SFIXED32)
    _add_field(message, "observation", _Field.TYPE_MESSAGE, f".{TRANSITION_SCHEMA}.Observation")
    if isinstance(spec.action, ContinuousAction):
        message.nested_type.append(_vector_message("Action", [each.name for each in spec.action.dimensions]))
        _add_field(message, "action", _Field.TYPE_MESSAGE, f".{TRANSITION_SCHEMA}.Action")
    else:
        _add_field(message, "action", _Field.TYPE_SFIXED64)
    _add_field(message, "reward", _Field.TYPE_FLOAT)
    _add_field(message, "next_observation", _Field.TYPE_MESSAGE, f".{TRANSITION_SCHEMA}.Observation")
    _add_field(message, "terminated", _Field.TYPE_BOOL)
    _add_field(message, "truncated", _Field.TYPE_BOOL)
    if spec.exogenous:
        message.nested_type.append(_vector_message("Exogenous", [each.name for each in spec.exogenous]))
        _add_field(message, "exogenous", _Field.TYPE_MESSAGE, f".{TRANSITION_SCHEMA}.Exogenous")
    file = _file("transition", message)
    _describe_dimensions(file, 0, spec.observation)
    if isinstance(spec.action, ContinuousAction):
        _describe_dimensions(file, 1, spec.action.dimensions)
    if spec.exogenous:
        _describe_dimensions(file, len(message.nested_type) - 1, spec.exogenous)
    return file


def episode_file() -> FileDescriptorProto:
    """Return the protobuf file whose only message is the record of an episode."""
    message = DescriptorProto(name="Episode")
    ended = EnumDescriptorProto(name="Ended")
    for number, name in enumerate(ENDED):
        ended.value.add(name=name.upper(), number=number)
    message.enum_type.append(ended)
    _add_field(message, "episode", _Field.TYPE_SFIXED64)
    _add_field(message, "seed", _Field.TYPE_SFIXED64)
    _add_field(message, "return", _Field.TYPE_DOUBLE)
    _add_field(message, "length", _Field.TYPE_SFIXED64)
    _add_field(message, "ended", _Field.TYPE_ENUM, f".{EPISODE_SCHEMA}.Ended")
    return _file("episode", message)


@lru_cache(maxsize=16)
def transition_layout(spec: SpaceSpec) -> MessageLayout:
    """Return the layout of the message of a transition."""
    return message_layout(transition_file(spec).message_type[0])


@lru_cache(maxsize=1)
def episode_layout() -> MessageLayout:
    """Return the layout of the record of an episode."""
    return message_layout(episode_file().message_type[0])


def schema_data(file: FileDescriptorProto) -> bytes:
    """Return the schema as MCAP embeds it: a serialised `FileDescriptorSet`."""
    return FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)


def _file(name: str, message: DescriptorProto) -> FileDescriptorProto:
    return FileDescriptorProto(name=f"{PACKAGE}/{name}.proto", package=PACKAGE, syntax="proto3", message_type=[message])


def _vector_message(name: str, dimensions: Sequence[str]) -> DescriptorProto:
    message = DescriptorProto(name=name)
    if not 1 <= len(dimensions) <= MOST_DIMENSIONS:
        text = f"the {name.lower()} has {len(dimensions)} dimensions, but a log takes 1 to {MOST_DIMENSIONS}"
        raise SpaceError(text)
    for dimension in dimensions:
        if not _IDENTIFIER.fullmatch(dimension):
            text = f"a dimension is called '{dimension}', but names are letters, digits and underscores; rename it"
            raise SpaceError(text)
        _add_field(message, dimension, _Field.TYPE_FLOAT)
    if len(set(dimensions)) < len(dimensions):
        text = f"two dimensions have the same name ({', '.join(dimensions)}); rename one"
        raise SpaceError(text)
    return message


def _describe_dimensions(file: FileDescriptorProto, nested_type: int, dimensions: Sequence[Dimension]) -> None:
    """Write units and bounds where viewers look for them: in the comments of the fields."""
    for index, dimension in enumerate(dimensions):
        bounds = (
            f"{dimension.low:g} to {dimension.high:g}" if np.isfinite([dimension.low, dimension.high]).all() else ""
        )
        if comment := ", ".join(filter(None, [dimension.unit, bounds])):
            # The path of a comment counts fields of descriptors: message_type 4, nested_type 3, field 2.
            path = [4, 0, 3, nested_type, 2, index]
            file.source_code_info.location.add(path=path, span=[0, 0, 0], leading_comments=f" {comment}\n")


def _add_field(
    message: DescriptorProto, name: str, kind: FieldDescriptorProto.Type.ValueType, type_name: str = ""
) -> None:
    number = len(message.field) + 1
    # The JSON name is given, because the default would make `x_1` and `x1` the same.
    field = message.field.add(name=name, json_name=name, number=number, type=kind, label=_Field.LABEL_OPTIONAL)
    if type_name:
        field.type_name = type_name
