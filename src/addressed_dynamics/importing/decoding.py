"""From the bytes of a message to its fields: JSON, protobuf and ROS 2 (CDR)."""

from __future__ import annotations

import json
from collections.abc import Callable
from typing import Any

import zstandard
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding

from addressed_dynamics.base.errors import LogError
from addressed_dynamics.importing.cdr import cdr_decoder

Decode = Callable[[bytes], Any]
"""Decodes a message; raises anything on one that is damaged."""
ZSTANDARD = bytes.fromhex("28b52ffd")
"""How data that zstd compressed begins."""
MOST_BYTES = 2**28
"""Largest message, once decompressed; a damaged size would ask for any number."""


def decoder_for(where: str, channel: Channel, schema: Schema | None) -> Decode:
    """Return what decodes the messages of a channel.

    Args:
        where: the file, for errors.
        channel: the channel.
        schema: its schema; JSON needs none.

    Raises:
        LogError: the encoding is unknown, or the schema is missing, of another encoding or cannot be read.
    """
    schema_encoding = schema.encoding if schema else ""
    try:
        match channel.message_encoding, schema_encoding:
            case (MessageEncoding.JSON, _):
                return json.loads
            case (MessageEncoding.Protobuf, SchemaEncoding.Protobuf) if schema:
                return _protobuf_decoder(schema)
            case (MessageEncoding.CDR, SchemaEncoding.ROS2 | SchemaEncoding.ROS2IDL) if schema:
                return cdr_decoder(schema.name, schema.encoding, schema.data.decode())
    except Exception as error:  # a damaged schema makes the parsers raise a dozen unrelated types
        message = (
            f"{where}: the schema of topic {channel.topic} cannot be read ({reason(error)}); leave the topic out, or "
            "record it again with a definition that is whole"
        )
        raise LogError(message) from error
    message = (
        f"{where}: topic {channel.topic} has messages in '{channel.message_encoding}' with a schema in "
        f"'{schema_encoding}', but json, protobuf and cdr with ros2msg or ros2idl can be read; convert the file"
    )
    raise LogError(message)


def unpacked(data: bytes) -> bytes:
    """Return a message as it was before it was compressed by itself, as rosbag2 does if it is asked to.

    No message in JSON or CDR begins as compressed data do; one in protobuf would have to hold an odd number in its
    fifth field and be sound compressed data all the same.

    Raises:
        ValueError: it begins as compressed data do, but is damaged or too large.
    """
    try:
        if zstandard.frame_content_size(data) > MOST_BYTES:
            message = f"it would have more than {MOST_BYTES} bytes once decompressed"
            raise ValueError(message)
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=MOST_BYTES, allow_extra_data=False)
    except zstandard.ZstdError as error:
        message = f"it begins as data do that zstd compressed, but is damaged ({reason(error)})"
        raise ValueError(message) from error


def reason(error: BaseException) -> str:
    """Return the first line of what an exception says, or its type if it says nothing."""
    text = str(error).strip().split("\n", maxsplit=1)[0]
    return text or type(error).__name__


def _protobuf_decoder(schema: Schema) -> Decode:
    files = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
    pool = DescriptorPool()
    added: set[str] = set()

    def add(file: FileDescriptorProto) -> None:
        # A file goes in after those it imports, and the set may have them in any order.
        added.add(file.name)
        for name in file.dependency:
            if name not in added:
                add(files[name])
        pool.Add(file)

    for file in files.values():
        if file.name not in added:
            add(file)
    decode: Decode = GetMessageClass(pool.FindMessageTypeByName(schema.name)).FromString
    return decode
