"""The fixed layout of a protobuf message: one NumPy dtype for encoding and decoding whole arrays of messages.

A protobuf field is a tag (field number and wire type), then its value; a sub-message has its length in between. If
every field is always written and every value has a fixed width, then all tags, lengths and positions are constants of
the message type: an encoded message is a record of a C-like structure, and any protobuf decoder still reads it.
Encoding as in https://protobuf.dev/programming-guides/encoding/.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import DescriptorProto, FieldDescriptorProto
from jaxtyping import Bool, Shaped, UInt8

_VARINT, _FIXED64, _LENGTH, _FIXED32 = 0, 1, 2, 5

# A bool or an enum below 128 is a varint of exactly one byte.
_SCALARS: dict[int, tuple[str, int]] = {
    FieldDescriptorProto.TYPE_FLOAT: ("<f4", _FIXED32),
    FieldDescriptorProto.TYPE_DOUBLE: ("<f8", _FIXED64),
    FieldDescriptorProto.TYPE_SFIXED32: ("<i4", _FIXED32),
    FieldDescriptorProto.TYPE_SFIXED64: ("<i8", _FIXED64),
    FieldDescriptorProto.TYPE_BOOL: ("|u1", _VARINT),
    FieldDescriptorProto.TYPE_ENUM: ("|u1", _VARINT),
}

Rows = Shaped[np.ndarray, " message"]
"""Messages as an array of a layout's dtype."""


@dataclass(frozen=True)
class MessageLayout:
    """Where everything stands in the bytes of a message."""

    template: UInt8[np.ndarray, " byte"]
    """The message with every value zero: its tags and lengths, and zeros."""
    constant: UInt8[np.ndarray, " byte"]
    """255 where a byte of a message must equal the template's, 0 where it belongs to a value."""
    dtype: np.dtype[Any]
    """A message as a record. A sub-message is one or more arrays of (tag, value) pairs of equal width."""
    parts: Mapping[str, tuple[str, ...]]
    """For each field of the message, the fields of `dtype` that make it up; none for an empty sub-message."""

    @property
    def size(self) -> int:
        """Length of a message in bytes."""
        return len(self.template)

    def values(self) -> Iterator[tuple[int, np.dtype[Any], str]]:
        """Yield the offset and type of every value, in order, and the field that it belongs to."""
        for name, parts in self.parts.items():
            for part in parts:
                kind, start = _field(self.dtype, part)
                if kind.subdtype is None:
                    yield start, kind, name
                else:
                    pair, (count,) = kind.subdtype
                    value, offset = _field(pair, "value")
                    for index in range(count):
                        yield start + index * pair.itemsize + offset, value, name

    def blank(self) -> Rows:
        """Return one writable message with every value zero."""
        return self.template.copy().view(self.dtype)

    def broken(self, messages: UInt8[np.ndarray, "message byte"]) -> Bool[np.ndarray, " message"]:
        """Return which messages are not in this layout: a tag or a length differs."""
        differs = messages ^ self.template
        differs &= self.constant
        # Down the columns is ten times as fast as along the rows, which only a broken log needs.
        if not np.bitwise_or.reduce(differs, axis=0).any():
            return np.zeros(len(messages), np.bool_)
        broken: Bool[np.ndarray, " message"] = differs.any(axis=1)
        return broken

    def scalar(self, rows: Rows, field: str) -> Shaped[np.ndarray, " message"]:
        """Return a view of a scalar field."""
        (part,) = self.parts[field]
        return rows[part]

    def vector_parts(self, rows: Rows, field: str) -> list[Shaped[np.ndarray, "message part"]]:
        """Return views of the values of a sub-message; side by side they are all its values, in order."""
        return [rows[part]["value"] for part in self.parts[field]]

    def vector(self, rows: Rows, field: str) -> Shaped[np.ndarray, "message value"]:
        """Return a copy of the values of a sub-message."""
        return np.concatenate(self.vector_parts(rows, field), axis=1)


def _field(dtype: np.dtype[Any], name: str) -> tuple[np.dtype[Any], int]:
    assert dtype.fields is not None
    kind, offset, *_ = dtype.fields[name]
    return kind, offset


def message_layout(message: DescriptorProto) -> MessageLayout:
    """Return the layout of a message of fixed-width scalars and of sub-messages of equal scalars.

    Raises:
        KeyError: the message has a field of another type.
    """
    template, constant = bytearray(), bytearray()
    fields: dict[str, tuple[Any, int]] = {}
    parts: dict[str, tuple[str, ...]] = {}
    nested = {each.name: each for each in message.nested_type}

    def add(data: bytes, *, is_constant: bool) -> None:
        template.extend(data)
        constant.extend((b"\xff" if is_constant else b"\x00") * len(data))

    for field in message.field:
        if field.type == FieldDescriptorProto.TYPE_MESSAGE:
            runs = list(_runs(nested[field.type_name.rpartition(".")[2]]))
            add(_varint(field.number << 3 | _LENGTH) + _varint(sum(run.size for run in runs)), is_constant=True)
            parts[field.name] = tuple(f"{field.name}.{index}" for index in range(len(runs)))
            for name, run in zip(parts[field.name], runs, strict=True):
                fields[name] = (run.dtype, len(template))
                for tag in run.tags:
                    add(tag, is_constant=True)
                    add(bytes(run.value.itemsize), is_constant=False)
        else:
            code, wire_type = _SCALARS[field.type]
            add(_varint(field.number << 3 | wire_type), is_constant=True)
            fields[field.name], parts[field.name] = (code, len(template)), (field.name,)
            add(bytes(np.dtype(code).itemsize), is_constant=False)
    dtype = np.dtype(
        {
            "names": list(fields),
            "formats": [code for code, _ in fields.values()],
            "offsets": [offset for _, offset in fields.values()],
            "itemsize": len(template),
        }
    )
    return MessageLayout(
        np.frombuffer(bytes(template), np.uint8), np.frombuffer(bytes(constant), np.uint8), dtype, parts
    )


@dataclass(frozen=True)
class _Run:
    """Fields of a sub-message, one after the other, of the same type and with tags of the same width."""

    tags: tuple[bytes, ...]
    value: np.dtype[Any]

    @property
    def dtype(self) -> tuple[np.dtype[Any], tuple[int]]:
        return np.dtype([("tag", np.uint8, (len(self.tags[0]),)), ("value", self.value)]), (len(self.tags),)

    @property
    def size(self) -> int:
        return sum(len(tag) + self.value.itemsize for tag in self.tags)


def _runs(message: DescriptorProto) -> Iterator[_Run]:
    tagged = [
        (code, _varint(field.number << 3 | wire_type))
        for field in message.field
        for code, wire_type in [_SCALARS[field.type]]
    ]
    for (code, _), group in groupby(tagged, key=lambda each: (each[0], len(each[1]))):
        yield _Run(tags=tuple(tag for _, tag in group), value=np.dtype(code))


def _varint(value: int) -> bytes:
    encoded = bytearray()
    while value > 0x7F:
        encoded.append(value & 0x7F | 0x80)
        value >>= 7
    encoded.append(value)
    return bytes(encoded)
