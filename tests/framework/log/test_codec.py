"""Messages that do not fit together are refused; schemas say what they hold."""

from __future__ import annotations

import dataclasses

import log_samples
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

from sonobench.log.codec import TYPES, decode, decode_samples, encode
from sonobench.log.schemas import FIELDS, descriptor_set, message_class
from sonobench.types import Scan


@pytest.mark.parametrize("shape", [[-1], [-2, -1], [3], [1, 1], []])
def test_an_array_whose_values_do_not_fill_its_shape_is_refused(shape):
    message = message_class("MeasurementFrame").FromString(encode("MeasurementFrame", Scan(0.0, [True, False])))
    del message.searched.shape[:]
    message.searched.shape.extend(shape)
    with pytest.raises(ValueError, match="searched has 2 values for shape"):
        decode("MeasurementFrame", message.SerializeToString())


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"format": "<f8"}, "format '<f8'"),
        ({"channels": 0}, "0 channels"),
        ({"first_sample": -1}, "sample -1"),
        ({"channels": 3}, "reshape"),
    ],
)
def test_a_sample_block_that_is_not_whole_float32_frames_is_refused(fields, said):
    whole = {"name": "a", "first_sample": 0, "rate_hz": 8.0, "channels": 2, "format": "<f4", "data": bytes(32)}
    with pytest.raises(ValueError, match=said):
        decode_samples(message_class("SampleBlock")(**{**whole, **fields}).SerializeToString())


def test_any_reader_of_protobuf_can_decode_a_frame_by_the_schema_in_the_file():
    scan = log_samples.scan(np.random.default_rng(1), 0.25)
    pool = DescriptorPool()
    for file in FileDescriptorSet.FromString(descriptor_set("MeasurementFrame")).file:
        pool.Add(file)
    frame = GetMessageClass(pool.FindMessageTypeByName("sonobench.MeasurementFrame")).FromString(encode("MeasurementFrame", scan))
    assert frame.time_s == 0.25
    assert list(frame.detections[0].z.value) == scan.detections[0].z.ravel().tolist()
    assert np.frombuffer(frame.fields[0].value.values.value, "<f4").tolist() == scan.fields["gcc"].values.ravel().tolist()


def test_every_field_of_a_type_that_travels_is_stored():
    elsewhere = {"RecordingHeader": {"arrays"}}  # messages of their own, on /array/NAME/geometry
    for name, kind in TYPES.items():
        stored = {field.split()[0] for field in FIELDS[name]}
        assert stored | elsewhere.get(name, set()) == {field.name for field in dataclasses.fields(kind)}, name


def test_a_schema_holds_only_what_it_needs():
    assert [m.name for m in FileDescriptorSet.FromString(descriptor_set("SampleBlock")).file[0].message_type] == ["SampleBlock"]
