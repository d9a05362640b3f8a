"""Spectra of directions: where sources are, and through a scan cache."""

from __future__ import annotations

import numpy as np
import pytest
from vector_sources import heard, spread

from sonobench.components import build
from sonobench.geometry import angles
from sonobench.log.scans import read_scans, write_scans
from sonobench.registry import Registry
from sonobench.types import Scan, Sensor, Setup, Space, identical

_NAMES = ("cumulant", "covariance", "gls")


def _made(name: str, **table: object):
    return build("spectrum", {"use": name, **table}, Registry.load())


def _setup() -> Setup:
    sensor = Sensor("avs", "avs", "direction", np.zeros((1, 3)), Space.of("azimuth_rad", "elevation_rad"))
    return Setup((sensor,), ("avs",), np.eye(4)[None], nominal={"p_d": 0.9, "clutter_per_scan": 0.2})


@pytest.mark.parametrize("name", _NAMES)
def test_a_source_stands_far_above_the_rest_of_the_sphere(name):
    rng = np.random.default_rng(1)
    u = spread(rng, 2, 60)
    field = _made(name).fields(heard(rng, u)[None])[0]
    at, away = (field.at(angles(v)[:, None], np.array([0]))[:, 0] for v in (u, -u.sum(axis=0, keepdims=True)))
    assert at.min() > 100 * 2 / (4 * np.pi)
    assert away.max() < 0.1 / (4 * np.pi)


@pytest.mark.parametrize("name", _NAMES)
def test_noise_alone_shows_nothing_anywhere(name):
    field = _made(name).fields(heard(np.random.default_rng(2), np.zeros((0, 3)), 4000)[None])[0]
    assert field.heard.all()
    assert not field.at(np.random.default_rng(3).normal(size=(50, 1, 2)), np.array([0])).any()


@pytest.mark.parametrize("name", _NAMES)
def test_stored_is_live_bit_for_bit(name, tmp_path):
    rng = np.random.default_rng(4)
    fields = _made(name).fields(np.stack([heard(rng, spread(rng, m, 60), 3000) for m in (1, 2)]))
    scans = [Scan(float(k), np.zeros(1, bool), (), {"spectrum": field}) for k, field in enumerate(fields)]
    write_scans(tmp_path / "scans.npz", _setup(), scans)
    _, again = read_scans(tmp_path / "scans.npz")
    assert identical(again, scans)
    z = rng.normal(size=(20, 1, 2))
    for a, b in zip(scans, again, strict=True):
        np.testing.assert_array_equal(a.fields["spectrum"].at(z, np.array([0])), b.fields["spectrum"].at(z, np.array([0])))


def test_three_sources_are_a_circle_to_the_covariance_and_three_peaks_to_the_cumulants():
    rng = np.random.default_rng(5)
    u = spread(rng, 3, 60)
    samples = heard(rng, u)[None]
    at = {n: _made(n).fields(samples)[0].at(angles(u)[:, None], np.array([0]))[:, 0].min() for n in _NAMES}
    assert min(at["cumulant"], at["gls"]) > 20 * at["covariance"]
