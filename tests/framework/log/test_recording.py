"""Recordings come back bit for bit, hash by content, and are there whole or not at all."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import log_samples
import numpy as np
import pytest

from sonobench.errors import InputError, LogError
from sonobench.log import Recording, open_recording, write_recording
from sonobench.log.layout import on_grid
from sonobench.types import Block, Detections, Header, Scan, Truth, identical


@pytest.fixture
def rendering():
    return log_samples.rendering()


@pytest.fixture
def stored(rendering, tmp_path):
    write_recording(tmp_path / "a.mcap", rendering)
    return open_recording(tmp_path / "a.mcap")


def _same(recording, rendering):
    assert identical(recording.header, rendering.header)
    assert identical(recording.truth, rendering.truth)
    assert identical(list(recording.scans()), list(rendering.scans))
    for array in rendering.header.arrays:
        assert identical(log_samples.joined(recording.blocks(), array.name), log_samples.joined(rendering.blocks, array.name))
    sources = {label: (float(rate), np.asarray(signal)) for label, (rate, signal) in rendering.sources.items()}
    assert identical(dict(recording.sources()), dict(sorted(sources.items())))


def test_a_stored_recording_is_the_rendering_bit_for_bit(stored, rendering):
    _same(stored, rendering)
    assert stored.provenance == {"seed": 0, "scene": {"name": "small", "sizes": [1.0, 2.0]}}


def test_a_recording_in_memory_is_the_stored_one(stored, rendering):
    live = Recording.of(rendering)
    _same(live, rendering)
    assert identical(list(live.blocks()), list(stored.blocks()))
    assert live.provenance == stored.provenance
    assert [live.input_sha, live.truth_sha, live.content_sha] == [stored.input_sha, stored.truth_sha, stored.content_sha]
    assert live.path is None


def test_special_floats_keep_their_bits(rendering, tmp_path):
    bits = np.array([0x7FF8000000000123, 0xFFF8000000000001, 0x8000000000000000, 1, 0x7FF0000000000000], np.uint64).view(np.float64)
    header = Header("bits", nominal={"minus_zero": -0.0}, given={"bits": bits})
    truth = Truth(bits[2:3], [1], np.tile(bits[:3], (1, 1, 1)), [[True]], [[False]])
    odd = rendering._replace(header=header, blocks=[], scans=[], truth=truth)
    write_recording(tmp_path / "bits.mcap", odd)
    read = open_recording(tmp_path / "bits.mcap")
    assert identical(read.header, header)
    assert identical(read.truth, truth)
    assert np.signbit(read.header.nominal["minus_zero"])


@pytest.mark.parametrize("block", [1, 79, 80, 81, 10_000])
def test_blocks_are_100_ms_in_time_order_whatever_lengths_were_rendered(tmp_path, block):
    write_recording(tmp_path / "b.mcap", log_samples.rendering(block=block))
    recording = open_recording(tmp_path / "b.mcap")
    blocks = list(recording.blocks())
    assert [len(b.samples) for b in blocks if b.array == "pair/left"] == [80] * 5
    assert [(b.array, b.first_sample) for b in blocks[:4]] == [("pair/left", 0), ("vector", 0), ("pair/left", 80), ("vector", 40)]
    assert recording.content_sha == Recording.of(log_samples.rendering()).content_sha


def test_a_gap_stays_a_gap(rendering, tmp_path):
    kept = [b for b in rendering.blocks if b.array == "vector" or not 100 <= b.first_sample < 200]
    write_recording(tmp_path / "gap.mcap", rendering._replace(blocks=kept))
    spans = [
        (b.first_sample, b.first_sample + len(b.samples)) for b in open_recording(tmp_path / "gap.mcap").blocks() if b.array == "pair/left"
    ]
    assert spans == [(0, 80), (80, 111), (222, 240), (240, 320), (320, 400)]


def test_cutting_to_the_grid_loses_no_sample():
    samples = np.arange(1000, dtype=np.float32)[:, None]
    for seed in range(20):
        edges = np.unique(np.random.default_rng(seed).integers(0, 1001, 12))
        runs = [(int(a), samples[a:b]) for a, b in zip([0, *edges], [*edges, 1000], strict=True)]
        cut = list(on_grid(runs, 70.0))
        assert [first for first, _ in cut] == list(range(0, 1000, 7))
        np.testing.assert_array_equal(np.concatenate([piece for _, piece in cut]), samples)


def test_scrambled_truth_changes_neither_input_hash_nor_header(rendering):
    other = rendering._replace(truth=log_samples.truth(np.random.default_rng(9), np.arange(3.0)), sources={}, provenance={"seed": 5})
    a, b = Recording.of(rendering), Recording.of(other)
    assert a.input_sha == b.input_sha
    assert a.truth_sha != b.truth_sha
    assert a.content_sha != b.content_sha


def test_provenance_is_in_no_hash(rendering):
    a, b = Recording.of(rendering), Recording.of(rendering._replace(provenance={"version": "other"}))
    assert (a.input_sha, a.truth_sha, a.content_sha) == (b.input_sha, b.truth_sha, b.content_sha)


@pytest.mark.parametrize("part", ["samples", "scans", "header"])
def test_the_input_hash_sees_every_part_that_a_pipeline_reads(rendering, part):
    first = rendering.blocks[0]
    touched = np.array(first.samples)
    touched[3, 0] = np.nextafter(touched[3, 0], np.float32(9))
    changed = {
        "samples": {"blocks": [Block(first.array, 0, touched), *rendering.blocks[1:]]},
        "scans": {"scans": rendering.scans[:-1]},
        "header": {"header": log_samples.rendering(seed=1).header},
    }[part]
    a, b = Recording.of(rendering), Recording.of(rendering._replace(**changed))
    assert a.input_sha != b.input_sha
    assert a.truth_sha == b.truth_sha


_WRITE = """
import sys, log_samples
from sonobench.log import write_recording, open_recording
write_recording(sys.argv[1], log_samples.rendering())
print(open_recording(sys.argv[1]).content_sha)
"""


def test_two_processes_write_equal_bytes(tmp_path):
    results = []
    for seed in ("1", "2"):
        path = tmp_path / f"{seed}.mcap"
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": os.pathsep.join(sys.path)}
        done = subprocess.run([sys.executable, "-c", _WRITE, str(path)], env=environment, capture_output=True, text=True, check=True)
        results.append((done.stdout, path.read_bytes()))
    assert results[0] == results[1]


def test_a_recording_pickles_by_what_it_reads(stored, rendering):
    for recording in (stored, Recording.of(rendering)):
        assert pickle.loads(pickle.dumps(recording)).content_sha == recording.content_sha


def test_what_is_read_is_read_only(stored):
    with pytest.raises(ValueError, match="read-only"):
        next(stored.blocks()).samples[0, 0] = 1
    with pytest.raises(ValueError, match="read-only"):
        stored.sources()["talker"][1][0] = 1


class _Peculiar:
    unit = "1"

    def at(self, z, sensor):
        return z[..., 0]


def _faulty(rendering):
    late = Block("pair/left", 10, np.zeros((5, 2)))
    return {
        "begins at sample 10": rendering._replace(blocks=[*rendering.blocks, late]),
        "the header does not have": rendering._replace(blocks=[Block("ghost", 0, np.zeros((5, 2)))]),
        "has 3 channels": rendering._replace(blocks=[Block("vector", 0, np.zeros((5, 3)))]),
        "time -1.0 s cannot be logged": rendering._replace(scans=[Scan(-1.0, [True, True])]),
        "'odd': a _Peculiar cannot be stored": rendering._replace(scans=[Scan(0.0, [True, True], fields={"odd": _Peculiar()})]),
        "provenance cannot be recorded": rendering._replace(provenance={"x": float("nan")}),
        "no JSON form": rendering._replace(provenance={"x": object()}),
        "two arrays have one name": rendering._replace(
            header=Header("twice", arrays=rendering.header.arrays[:1] * 2, poses=np.stack([np.eye(4)] * 2))
        ),
    }


@pytest.mark.parametrize("said", _faulty(log_samples.rendering()))
def test_what_cannot_be_recorded_is_refused_and_leaves_nothing_behind(rendering, tmp_path, said):
    path = tmp_path / "bad.mcap"
    with pytest.raises(LogError, match=said) as caught:
        write_recording(path, _faulty(rendering)[said])
    assert str(caught.value).startswith(f"{path}: ")
    assert list(tmp_path.iterdir()) == []


def test_an_exception_inside_the_writer_keeps_the_file_that_was_there(stored, tmp_path):
    class Broken(list):
        def __iter__(self):
            raise RuntimeError("boom")

    before = stored.path.read_bytes()
    with pytest.raises(RuntimeError, match="boom"):
        write_recording(stored.path, log_samples.rendering()._replace(scans=Broken()))
    assert stored.path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [stored.path]


def test_a_missing_folder_is_the_users_fault(rendering, tmp_path):
    with pytest.raises(InputError, match="cannot be written"):
        write_recording(tmp_path / "no" / "a.mcap", rendering)


def test_an_unset_group_reads_as_empty(rendering, tmp_path):
    silent = rendering._replace(blocks=[], scans=[], sources={})
    write_recording(tmp_path / "e.mcap", silent)
    read = open_recording(tmp_path / "e.mcap")
    assert (list(read.blocks()), list(read.scans()), dict(read.sources())) == ([], [], {})


def test_detections_keep_none_apart_from_no_rows(rendering, tmp_path):
    none = Scan(0.0, [True, True])
    empty = Scan(0.1, [True, True], (Detections(np.zeros((0, 2)), [], R=np.zeros((0, 2, 2))),))
    write_recording(tmp_path / "d.mcap", rendering._replace(scans=[none, empty]))
    assert identical(list(open_recording(tmp_path / "d.mcap").scans()), [none, empty])
