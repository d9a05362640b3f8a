"""Estimates and cached scans come back bit for bit."""

from __future__ import annotations

import dataclasses

import log_samples
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench.errors import LogError
from sonobench.log import Recording, estimates_sha, read_estimates, read_scans, write_estimates, write_scans
from sonobench.types import Estimate, Scan, Setup, Space, identical

SPACE = Space.of("x_m", "vx_m_s", "azimuth_rad")


@settings(max_examples=40, deadline=None)
@given(estimates=st.lists(log_samples.estimates(), max_size=3))
def test_estimates_round_trip(estimates, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "estimates.mcap"
    write_estimates(path, estimates, SPACE, {"run": 1})
    read, space, meta = read_estimates(path)
    assert identical(read, estimates)
    assert identical(space, SPACE)
    assert meta == {"run": 1}
    assert estimates_sha(read, space) == estimates_sha(estimates, SPACE)


def test_meta_keeps_order_apart_and_takes_numpy_values(tmp_path):
    for name, meta in [("a", {"x": np.float64(0.1), "y": {"b": (1, 2)}}), ("b", {"y": {"b": [1, 2]}, "x": 0.1})]:
        write_estimates(tmp_path / name, [], SPACE, meta)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert read_estimates(tmp_path / "a")[2] == {"x": 0.1, "y": {"b": [1, 2]}}


def test_the_hash_of_estimates_sees_states_and_space_but_not_info():
    one = Estimate(1.0, np.ones((1, 3)))
    assert estimates_sha([one], SPACE) == estimates_sha([dataclasses.replace(one, info={"ms": 3.0})], SPACE)
    assert estimates_sha([one], SPACE) != estimates_sha([dataclasses.replace(one, states=np.zeros((1, 3)))], SPACE)
    assert estimates_sha([one], SPACE) != estimates_sha([dataclasses.replace(one, count=1.0)], SPACE)
    assert estimates_sha([one], SPACE) != estimates_sha([one], Space.of("x_m", "y_m", "z_m"))


@pytest.mark.parametrize(
    ("estimates", "meta"), [([Estimate(-1.0, np.zeros((0, 3)))], {}), ([], {"x": float("inf")}), ([], {"x": object()})]
)
def test_estimates_that_cannot_be_logged_leave_nothing_behind(tmp_path, estimates, meta):
    with pytest.raises(LogError, match=r"e\.mcap: the estimates cannot be written"):
        write_estimates(tmp_path / "e.mcap", estimates, SPACE, meta)
    assert list(tmp_path.iterdir()) == []


@settings(max_examples=40, deadline=None)
@given(scans=st.lists(log_samples.scans(), max_size=3))
def test_scans_round_trip_in_a_recording_and_in_the_cache(scans, tmp_path_factory):
    path = tmp_path_factory.getbasetemp() / "scans.npz"
    rendering = log_samples.rendering(duration_s=0.1)
    setup = Setup.from_header(rendering.header, rendering.header.sensors, 0.1)
    write_scans(path, setup, scans)
    read_setup, read = read_scans(path)
    assert identical(read_setup, setup)
    assert identical(read, scans)
    assert identical(list(Recording.of(rendering._replace(scans=scans)).scans()), scans)


def test_a_bare_setup_round_trips(tmp_path):
    setup = Setup(())
    write_scans(tmp_path / "s.npz", setup, [])
    read, scans = read_scans(tmp_path / "s.npz")
    assert identical(read, setup)
    assert scans == []


class _Curve:
    unit = "1"

    def at(self, z, sensor):
        return z[..., 0]


def test_scans_with_a_plugins_own_field_are_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ValueError, match="'mine': a _Curve cannot be stored"):
        write_scans(tmp_path / "s.npz", Setup(()), [Scan(0.0, [], fields={"mine": _Curve()})])
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_cache_file_is_one_log_error(tmp_path):
    path = tmp_path / "s.npz"
    rng = np.random.default_rng(2)
    scans = [log_samples.scan(rng, t) for t in range(3)]
    write_scans(path, Setup(()), scans)
    whole = path.read_bytes()
    for _ in range(150):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged if rng.random() < 0.6 else whole[: rng.integers(len(whole))])
        try:
            read, said = read_scans(path)[1], f"{path}: "
        except LogError as error:
            read, said = scans, str(error)
        assert identical(read, scans)
        assert said.startswith(f"{path}: ")
    with pytest.raises(LogError, match="no such file"):
        read_scans(tmp_path / "none.npz")


def test_an_array_of_objects_is_never_unpickled(tmp_path):
    np.savez(tmp_path / "s.npz", format=np.array([print], dtype=object))
    with pytest.raises(LogError, match="delete it"):
        read_scans(tmp_path / "s.npz")
