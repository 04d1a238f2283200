"""The messages of Foxglove that a scene is made of, as their published schemas have them.

Described here rather than taken from a package: a descriptor of what is used is all that a log needs to be read.
Source: https://docs.foxglove.dev/docs/sdk/schemas (`SceneUpdate`, `FrameTransforms` and what they are made of).
"""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf import duration_pb2, timestamp_pb2
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

PACKAGE = "foxglove"

_FIELDS = {
    "Vector3": "double x, double y, double z",
    "Point3": "double x, double y, double z",
    "Quaternion": "double x, double y, double z, double w",
    "Color": "double r, double g, double b, double a",
    "Pose": "Vector3 position, Quaternion orientation",
    "KeyValuePair": "string key, string value",
    "ArrowPrimitive": "Pose pose, double shaft_length, double shaft_diameter, double head_length, "
    "double head_diameter, Color color",
    "CubePrimitive": "Pose pose, Vector3 size, Color color",
    "SpherePrimitive": "Pose pose, Vector3 size, Color color",
    "CylinderPrimitive": "Pose pose, Vector3 size, double bottom_scale, double top_scale, Color color",
    "LinePrimitive": "Type type, Pose pose, double thickness, bool scale_invariant, Point3* points, Color color, "
    "Color* colors, fixed32* indices",
    "TriangleListPrimitive": "Pose pose, Point3* points, Color color, Color* colors, fixed32* indices",
    "TextPrimitive": "Pose pose, bool billboard, double font_size, bool scale_invariant, Color color, string text",
    "ModelPrimitive": "Pose pose, Vector3 scale, Color color, bool override_color, string url, string media_type, "
    "bytes data",
    "SceneEntityDeletion": "Timestamp timestamp, Type type, string id",
    "SceneEntity": "Timestamp timestamp, string frame_id, string id, Duration lifetime, bool frame_locked, "
    "KeyValuePair* metadata, ArrowPrimitive* arrows, CubePrimitive* cubes, SpherePrimitive* spheres, "
    "CylinderPrimitive* cylinders, LinePrimitive* lines, TriangleListPrimitive* triangles, TextPrimitive* texts, "
    "ModelPrimitive* models",
    "SceneUpdate": "SceneEntityDeletion* deletions, SceneEntity* entities",
    "FrameTransform": "Timestamp timestamp, string parent_frame_id, string child_frame_id, Vector3 translation, "
    "Quaternion rotation",
    "FrameTransforms": "FrameTransform* transforms",
}
"""Type and name of each message's fields, in the order of their numbers, which begin at 1; * if there are several."""
_ENUMS = {
    "LinePrimitive": ("LINE_STRIP", "LINE_LOOP", "LINE_LIST"),
    "SceneEntityDeletion": ("MATCHING_ID", "ALL"),
}
"""Values of the enumeration `Type` of a message, in the order of their numbers, which begin at 0."""
_SCALARS = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "bool": FieldDescriptorProto.TYPE_BOOL,
    "string": FieldDescriptorProto.TYPE_STRING,
    "bytes": FieldDescriptorProto.TYPE_BYTES,
    "fixed32": FieldDescriptorProto.TYPE_FIXED32,
}


@cache
def schemas() -> FileDescriptorSet:
    """Return the descriptors of all messages, and of the two of Google that they contain."""
    file = FileDescriptorProto(name=f"{PACKAGE}/scene.proto", package=PACKAGE, syntax="proto3")
    needed = [FileDescriptorProto(), FileDescriptorProto()]
    for module, each in zip((duration_pb2, timestamp_pb2), needed, strict=True):
        module.DESCRIPTOR.CopyToProto(each)
        file.dependency.append(each.name)
    for name, fields in _FIELDS.items():
        message = file.message_type.add(name=name)
        if name in _ENUMS:
            enumeration = message.enum_type.add(name="Type")
            for number, value in enumerate(_ENUMS[name]):
                enumeration.value.add(name=value, number=number)
        for number, words in enumerate(fields.split(", "), start=1):
            kind, field_name = words.split()
            field = message.field.add(name=field_name, number=number)
            several = kind.endswith("*")
            field.label = FieldDescriptorProto.LABEL_REPEATED if several else FieldDescriptorProto.LABEL_OPTIONAL
            _set_type(field, name, kind.removesuffix("*"))
    return FileDescriptorSet(file=[*needed, file])


def _set_type(field: FieldDescriptorProto, message: str, kind: str) -> None:
    if kind in _SCALARS:
        field.type = _SCALARS[kind]
    elif kind == "Type":
        field.type, field.type_name = FieldDescriptorProto.TYPE_ENUM, f".{PACKAGE}.{message}.Type"
    else:
        package = "google.protobuf" if kind in ("Timestamp", "Duration") else PACKAGE
        field.type, field.type_name = FieldDescriptorProto.TYPE_MESSAGE, f".{package}.{kind}"


@cache
def message_class(name: str) -> Any:
    """Return the class of a message, by its name in the package."""
    return GetMessageClass(_pool().FindMessageTypeByName(f"{PACKAGE}.{name}"))


@cache
def _pool() -> DescriptorPool:
    pool = DescriptorPool()
    for file in schemas().file:
        pool.Add(file)
    return pool
