"""From the bytes of a message to its fields: JSON, protobuf and ROS 2 (CDR)."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from contextlib import redirect_stderr
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap_ros2.decoder import DecoderFactory

from addressed_dynamics.base.errors import LogError

Decode = Callable[[bytes], Any]
"""Decodes a message; raises anything on one that is damaged."""


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
            case (MessageEncoding.CDR, SchemaEncoding.ROS2):
                # The parser prints the line that it cannot read, beside raising an error.
                with redirect_stderr(io.StringIO()):
                    decode: Decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
                return decode
    except Exception as error:  # a damaged schema makes the parsers raise a dozen unrelated types
        message = f"{where}: the schema of topic {channel.topic} cannot be read ({reason(error)}); record it again"
        raise LogError(message) from error
    message = (
        f"{where}: topic {channel.topic} has messages in '{channel.message_encoding}' with a schema in "
        f"'{schema_encoding}', but json, protobuf and cdr with ros2msg can be read; convert the file"
    )
    raise LogError(message)


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
