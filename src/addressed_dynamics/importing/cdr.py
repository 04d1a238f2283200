"""ROS 2 messages (CDR): from their bytes to their fields; what cannot be what its definition says is refused."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

from mcap.well_known import SchemaEncoding
from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

ENCAPSULATIONS = {
    0x0002: "a parameter list (PL_CDR)",
    0x0003: "a parameter list (PL_CDR)",
    0x0006: "XCDR2",
    0x0007: "XCDR2",
    0x0008: "delimited XCDR2",
    0x0009: "delimited XCDR2",
    0x000A: "a parameter list of XCDR2",
    0x000B: "a parameter list of XCDR2",
}
"""How a payload is encoded that is no plain CDR, by its first two bytes (DDS-XTypes 1.3, table 60)."""
MOST_ELEMENTS = 2**24
"""Most elements of an array in a message; a damaged length would ask for any number."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")
_PARTS = re.compile(r"^={80}\nIDL: .*$", re.MULTILINE)
# Stands before the definition of each type where there are several.
_UNSIGNED = {"byte": "uint8", "char": "uint8"}
# Both are one unsigned byte in ROS 2 (rosidl: octet and uint8); libraries take one or the other as signed.
_BUILT_IN = {
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "builtin_interfaces/Duration": "int32 sec\nuint32 nanosec",
}
# Definitions in logs often leave out what every installation has.


@lru_cache(maxsize=64)  # a folder of logs has a few definitions, and each is compiled
def cdr_decoder(name: str, encoding: str, text: str) -> Callable[[bytes], Any]:
    """Return what decodes messages of a ROS 2 type.

    Args:
        name: the type, for instance `sensor_msgs/msg/JointState`.
        encoding: `ros2msg` or `ros2idl`.
        text: its definition, followed by those of the types in it.

    Returns:
        A function from the bytes of a message, with its header of four bytes, to an object that has the fields as
        attributes; it raises ValueError on bytes that cannot be such a message, and on anything left over behind it.

    Raises:
        ValueError: the definition is malformed or incomplete, or has a type that cannot be read.
    """
    if not _NAME.fullmatch(name):
        message = f"'{name[:80]}' is not the name of a type"
        raise ValueError(message)
    types = _parsed(name, encoding, text)
    for built_in, definition in _BUILT_IN.items():
        for full_name, fields in get_types_from_msg(definition, built_in).items():
            types.setdefault(full_name, fields)
    own = next((each for each in types if _short(each) == _short(name)), None)
    if own is None:
        message = f"it does not define {name}"
        raise ValueError(message)
    types = {each: (constants, [(field, _unsigned(form)) for field, form in fields])
             for each, (constants, fields) in types.items()}  # fmt: skip
    _check_complete(own, types)
    store = get_typestore(Stores.EMPTY)
    store.max_sequence_length = MOST_ELEMENTS
    store.register(types)

    def decode(data: bytes) -> Any:
        if data[:1] != b"\0" or data[1:2] not in (b"\0", b"\1"):
            raise ValueError(_encapsulation(data))
        try:
            return store.deserialize_cdr(data, own)
        except SerdeError as error:
            message = f"its {len(data)} bytes do not fit the definition of {name}: {error}"
            raise ValueError(message) from error

    return decode


def _parsed(name: str, encoding: str, text: str) -> dict[str, Any]:
    try:
        if encoding != SchemaEncoding.ROS2IDL:
            return dict(get_types_from_msg(text, name))
        types = dict[str, Any]()
        for part in _PARTS.split(text):
            types |= get_types_from_idl(part) if part.strip() else {}
        return types
    except TypesysError as error:
        raise ValueError(" ".join(str(error).split())[:200]) from error


def _encapsulation(data: bytes) -> str:
    if len(data) < 4:
        return f"it has {len(data)} bytes, too few for a message"
    kind = ENCAPSULATIONS.get(int.from_bytes(data[:2], "big"), "no encoding of messages that is known")
    return f"its first bytes, {data[:4].hex(' ')}, say that it is {kind}, and plain CDR (00 00 or 00 01) can be read"


def _short(name: str) -> tuple[str, ...]:
    return tuple(part for part in name.split("/") if part != "msg")


def _unsigned(form: Any) -> Any:
    match form:
        case (Nodetype.BASE, (base, bound)):
            return (Nodetype.BASE, (_UNSIGNED.get(base, base), bound))
        case (Nodetype.ARRAY | Nodetype.SEQUENCE as container, (element, count)):
            return (container, (_unsigned(element), count))
        case _:
            return form


def _check_complete(own: str, types: Mapping[str, Any]) -> None:
    """Refuse a definition that needs others which are not there, or a text of wide characters."""
    waiting, seen = [own], set[str]()
    while waiting:
        name = waiting.pop()
        if name in seen:
            continue
        seen.add(name)
        for field, form in types[name][1]:
            inner = form[1][0] if form[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else form
            if inner[0] != Nodetype.NAME:
                continue
            if inner[1].endswith("/wstring"):
                message = f"its field '{field}' is a wstring, and a message with one cannot be read, wherever it stands"
                raise ValueError(message)
            if inner[1] not in types:
                message = f"it does not define {inner[1]}, the type of its field '{field}'"
                raise ValueError(message)
            waiting.append(inner[1])
