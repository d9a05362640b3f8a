"""The protobuf schemas of Sonobench's MCAP files, built without protoc, and their mapping to the types that travel.

A table of fields is the only declaration: a field's number is its place in its row, so rows grow at their end and
never change. Messages are proto2 (a field that is absent is None); arrays are messages of a shape and packed values,
so that None, no rows and any shape come back as they went. Serialisation is deterministic, floats keep every bit.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

PACKAGE = "sonobench"

#: message → its fields as "name type"; a type that ends in [] is repeated (packed where it is a number)
FIELDS: dict[str, tuple[str, ...]] = {
    # arrays, row-major
    "Doubles": ("shape int64[]", "value double[]"),
    "Integers": ("shape int64[]", "value sint64[]"),
    "Flags": ("shape int64[]", "value bool[]"),
    "Floats": ("shape int64[]", "value bytes"),  # little-endian float32
    # entries of mappings
    "NamedNumber": ("name string", "value double"),
    "NamedArray": ("name string", "value Doubles"),
    "NamedTable": ("name string", "value DelayTable", "spectrum DirectionSpectrum"),  # a field: one of the two
    # what a recording says of itself
    "Space": ("names string[]", "periods double[]"),
    "Sensor": ("name string", "array string", "kind string", "elements Doubles", "space Space", "pairs Integers"),
    "ArrayGeometry": ("name string", "kind string", "elements Doubles", "rate_hz double", "pairs Integers"),
    "RecordingHeader": (
        "name string",
        "poses Doubles",
        "sensors Sensor[]",
        "array_names string[]",
        "start_s double",
        "duration_s double",
        "period_s double",
        "c_m_s double",
        "box_m Doubles",
        "reflections Doubles",
        "band_hz Doubles",
        "nominal NamedNumber[]",
        "given NamedArray[]",
    ),
    "Setup": (
        "sensors Sensor[]",
        "array_names string[]",
        "poses Doubles",
        "start_s double",
        "period_s double",
        "c_m_s double",
        "rate_hz double",
        "box_m Doubles",
        "reflections Doubles",
        "nominal NamedNumber[]",
        "given NamedArray[]",
    ),
    # truth: once what does not change, then a frame for every evaluation time
    "Targets": ("label int64[]", "times int64", "period_s double", "parameters NamedNumber[]", "has_velocity bool", "has_mode bool"),
    "TrackFrame": (
        "time_s double",
        "position double[]",  # (n, 3) m
        "exists bool[]",
        "active bool[]",
        "velocity double[]",  # (n, 3) m/s
        "mode sint64[]",
        "valid bool",
    ),
    # what was heard, measured and estimated
    "SampleBlock": ("name string", "first_sample int64", "rate_hz double", "channels int64", "format string", "data bytes"),
    "Detections": ("z Doubles", "sensor Integers", "R Doubles", "score Doubles", "valid Flags"),
    "DelayTable": ("values Floats", "start_s double", "step_s double", "unit string"),
    "DirectionSpectrum": ("noise Doubles", "spread Doubles", "height Doubles", "power Doubles", "heard Flags"),
    "MeasurementFrame": (
        "time_s double",
        "searched Flags",
        "detections Detections[]",
        "fields NamedTable[]",
        "pose Doubles",
        "extra NamedArray[]",
    ),
    "EstimateFrame": (
        "time_s double",
        "states Doubles",
        "covs Doubles",
        "labels Integers",
        "existence Doubles",
        "count double",
        "info NamedNumber[]",
    ),
}


@cache
def message_class(name: str) -> Any:
    """The generated class of the message `name`."""
    return message_factory.GetMessageClass(_pool().FindMessageTypeByName(f"{PACKAGE}.{name}"))


@cache
def descriptor_set(name: str) -> bytes:
    """What an MCAP schema record holds: a serialised FileDescriptorSet of `name` and the messages it is made of."""
    return FileDescriptorSet(file=[_file(_closure(name))]).SerializeToString(deterministic=True)


@cache
def _pool() -> Any:
    pool = descriptor_pool.DescriptorPool()
    pool.Add(_file(tuple(FIELDS)))
    return pool


def _closure(name: str) -> tuple[str, ...]:
    """`name` and every message that it reaches, in the order of the table."""
    reached, open_ = {name}, [name]
    while open_:
        used = {field.split()[1].removesuffix("[]") for field in FIELDS[open_.pop()]}
        open_ += (used & FIELDS.keys()) - reached
        reached |= used & FIELDS.keys()
    return tuple(m for m in FIELDS if m in reached)


def _file(names: tuple[str, ...]) -> FileDescriptorProto:
    file = FileDescriptorProto(name=f"{PACKAGE}.proto", package=PACKAGE)
    for name in names:
        message = file.message_type.add(name=name)
        for number, field in enumerate(FIELDS[name], start=1):
            _add_field(message, number, *field.split())
    return file


def _add_field(message: Any, number: int, name: str, kind: str) -> None:
    repeated, kind = kind.endswith("[]"), kind.removesuffix("[]")
    label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
    field = message.field.add(name=name, number=number, label=label)
    if kind in FIELDS:
        field.type = FieldDescriptorProto.TYPE_MESSAGE
        field.type_name = f".{PACKAGE}.{kind}"
        return
    field.type = FieldDescriptorProto.Type.Value(f"TYPE_{kind.upper()}")
    if repeated and kind != "string":
        field.options.packed = True
