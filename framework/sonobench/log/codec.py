"""The types that travel ↔ protobuf bytes, driven by the table of `schemas`: a message's field is the attribute of the same name."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import cache, partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sonobench.log.schemas import FIELDS, message_class
from sonobench.types import DelayTable, Detections, DirectionSpectrum, Estimate, Header, MicArray, Scan, Sensor, Setup, Space, Truth

#: message → the type that it carries
TYPES: Mapping[str, type] = {
    "Space": Space,
    "Sensor": Sensor,
    "ArrayGeometry": MicArray,
    "RecordingHeader": Header,
    "Setup": Setup,
    "Detections": Detections,
    "DelayTable": DelayTable,
    "DirectionSpectrum": DirectionSpectrum,
    "MeasurementFrame": Scan,
    "EstimateFrame": Estimate,
}
_ARRAYS = {"Doubles": np.float64, "Integers": np.int64, "Flags": np.bool_}
_FLOAT32 = np.dtype("<f4")


def encode(name: str, value: Any) -> bytes:
    """Bytes of `value` as the message `name`, the same in every process.

    Raises:
        ValueError: a part of it is of a type that cannot be stored, such as a plugin's own field.
    """
    return serialise(_pack(name, value))


def decode(name: str, data: bytes, **more: Any) -> Any:
    """What `encode` was given; `more` are constructor arguments that the message does not hold.

    Raises:
        ValueError, google.protobuf.message.DecodeError: the bytes are no such message, or do not fit together.
    """
    return _unpack(name, message_class(name).FromString(data), more)


def serialise(message: Any) -> bytes:
    """Deterministic bytes of a message."""
    return bytes(message.SerializeToString(deterministic=True))


def encode_truth(truth: Truth) -> tuple[bytes, Iterator[bytes]]:
    """A Targets message and a TrackFrame for every evaluation time."""
    targets = message_class("Targets")(
        label=truth.label.tolist(),
        times=len(truth.time_s),
        period_s=truth.period_s,
        parameters=[message_class("NamedNumber")(name=k, value=v) for k, v in truth.parameters.items()],
        has_velocity=truth.velocity is not None,
        has_mode=truth.mode is not None,
    )
    return serialise(targets), (serialise(_track_frame(truth, k)) for k in range(len(truth.time_s)))


def decode_truth(targets: bytes, frames: Iterable[bytes]) -> Truth:
    """What `encode_truth` was given.

    Raises:
        ValueError: frames are missing or do not have the targets' number of columns.
    """
    head = message_class("Targets").FromString(targets)
    frame_class = message_class("TrackFrame")
    rows = [frame_class.FromString(frame) for frame in frames]
    if len(rows) != head.times:
        raise ValueError(f"truth has {len(rows)} of {head.times} frames")
    n = len(head.label)

    def column(name: str, dtype: Any, *tail: int) -> NDArray[Any]:
        return np.array([getattr(row, name)[:] for row in rows], dtype).reshape(len(rows), n, *tail)

    return Truth(
        time_s=np.array([row.time_s for row in rows], np.float64),
        label=np.array(head.label[:], np.int64),
        position=column("position", np.float64, 3),
        exists=column("exists", np.bool_),
        active=column("active", np.bool_),
        velocity=column("velocity", np.float64, 3) if head.has_velocity else None,
        mode=column("mode", np.int64) if head.has_mode else None,
        valid=np.array([row.valid for row in rows], np.bool_),
        period_s=head.period_s if head.HasField("period_s") else None,
        parameters={entry.name: entry.value for entry in head.parameters},
    )


class Samples(NamedTuple):
    """A SampleBlock: `samples` (n, channels) float32 of the array or source `name`, from `first_sample` on."""

    name: str
    first_sample: int
    rate_hz: float
    samples: NDArray[np.float32]


def encode_samples(block: Samples) -> bytes:
    """Bytes of a SampleBlock, interleaved little-endian float32."""
    message = message_class("SampleBlock")(
        name=block.name,
        first_sample=block.first_sample,
        rate_hz=block.rate_hz,
        channels=block.samples.shape[1],
        format=_FLOAT32.str,
        data=np.ascontiguousarray(block.samples, _FLOAT32).tobytes(),
    )
    return serialise(message)


def decode_samples(data: bytes) -> Samples:
    """What `encode_samples` was given.

    Raises:
        ValueError: the block's format is another one, or its bytes are not a whole number of frames.
    """
    message = message_class("SampleBlock").FromString(data)
    if message.format != _FLOAT32.str:
        raise ValueError(f"samples of {message.name!r} are in format {message.format!r}; {_FLOAT32.str!r} is needed")
    if message.channels < 1 or message.first_sample < 0:
        raise ValueError(f"a block of {message.name!r} has {message.channels} channels from sample {message.first_sample}")
    samples = np.frombuffer(message.data, _FLOAT32).astype(np.float32, copy=False).reshape(-1, message.channels)
    return Samples(message.name, message.first_sample, message.rate_hz, samples)


def _track_frame(truth: Truth, k: int) -> Any:
    return message_class("TrackFrame")(
        time_s=truth.time_s[k],
        position=truth.position[k].ravel().tolist(),
        exists=truth.exists[k].tolist(),
        active=truth.active[k].tolist(),
        velocity=None if truth.velocity is None else truth.velocity[k].ravel().tolist(),
        mode=None if truth.mode is None else truth.mode[k].tolist(),
        valid=None if truth.valid is None else bool(truth.valid[k]),
    )


def _pack(name: str, value: Any) -> Any:
    if type(value) is not TYPES[name]:
        raise ValueError(f"a {type(value).__name__} cannot be stored where a {TYPES[name].__name__} is")
    parts = {field: put(getattr(value, field)) for field, put, _ in _plan(name)}
    return message_class(name)(**parts)


def _unpack(name: str, message: Any, more: Mapping[str, Any] = {}) -> Any:
    return TYPES[name](**{field: take(message, field) for field, _, take in _plan(name)}, **more)


_Put = Callable[[Any], Any]
_Take = Callable[[Any, str], Any]


@cache
def _plan(name: str) -> tuple[tuple[str, _Put, _Take], ...]:
    """How each field of a message is packed and unpacked."""
    fields = (field.split() for field in FIELDS[name])
    return tuple((field, *_converters(kind)) for field, kind in fields)


@cache
def _converters(kind: str) -> tuple[_Put, _Take]:
    item = kind.removesuffix("[]")
    if item in _ARRAYS or item == "Floats":
        return partial(_put_array, item), partial(_take_array, item)
    if item.startswith("Named"):
        return partial(_put_mapping, item), partial(_take_mapping, item)
    if item in TYPES and kind.endswith("[]"):
        return lambda values: [_pack(item, v) for v in values], lambda m, f: tuple(_unpack(item, v) for v in getattr(m, f))
    if item in TYPES:
        return partial(_pack, item), lambda m, f: _unpack(item, getattr(m, f))
    if kind.endswith("[]"):
        return list, lambda m, f: tuple(getattr(m, f))
    if kind == "string":
        return str, getattr
    return lambda value: value, lambda m, f: getattr(m, f) if m.HasField(f) else None


def _put_array(kind: str, array: NDArray[Any] | None) -> Any:
    if array is None:
        return None
    value = np.ascontiguousarray(array, _FLOAT32).tobytes() if kind == "Floats" else array.ravel().tolist()
    return message_class(kind)(shape=array.shape, value=value)


def _take_array(kind: str, message: Any, field: str) -> NDArray[Any] | None:
    if not message.HasField(field):
        return None
    stored = getattr(message, field)
    shape, value = tuple(stored.shape), stored.value
    if kind == "Floats":
        array = np.frombuffer(value, _FLOAT32).astype(np.float32, copy=False)
    else:
        array = np.array(value[:], _ARRAYS[kind])
    if min(shape, default=0) < 0 or math.prod(shape) != array.size:
        raise ValueError(f"{field} has {array.size} values for shape {shape}")
    return array.reshape(shape)


def _put_mapping(kind: str, values: Mapping[str, Any]) -> list[Any]:
    return [_put_entry(kind, name, values[name]) for name in sorted(values)]


def _put_entry(kind: str, name: str, value: Any) -> Any:
    """An entry of the mapping, its value in the field that carries its type, or else in the first."""
    fields = _values(kind)
    field = next((f for f, item in fields if TYPES.get(item) is type(value)), fields[0][0])
    put = _converters(dict(fields)[field])[0]
    try:
        return message_class(kind)(**{"name": name, field: put(value)})
    except ValueError as error:
        raise ValueError(f"{name!r}: {error}") from None


def _take_mapping(kind: str, message: Any, field: str) -> dict[str, Any]:
    return {entry.name: _take_entry(kind, entry) for entry in getattr(message, field)}


def _take_entry(kind: str, entry: Any) -> Any:
    """The value of an entry of a mapping, from whichever field holds it."""
    fields = _values(kind)
    field = next((f for f, _ in fields if len(fields) > 1 and entry.HasField(f)), fields[0][0])
    return _converters(dict(fields)[field])[1](entry, field)


@cache
def _values(kind: str) -> tuple[tuple[str, str], ...]:
    """The fields of a mapping's entries that may hold the value, and their types."""
    return tuple((name, item) for name, item in (field.split() for field in FIELDS[kind][1:]))
