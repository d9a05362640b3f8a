"""Directions from cumulants and covariances: a few sources, quickly; figures are the study's."""

from __future__ import annotations

import numpy as np
import pytest
from vector_sources import errors, heard, spread

from sonobench.components import build
from sonobench.geometry import angles
from sonobench.registry import Registry

_NAMES = ("cumulant-peaks", "covariance-peaks", "gls", "cumulant-gls")


def _made(name: str, **table: object):
    return build("direction", {"use": name, **table}, Registry.load())


@pytest.mark.parametrize("name", _NAMES)
def test_two_sources_are_found_with_their_errors(name):
    rng = np.random.default_rng(1)
    u = spread(rng, 2, 60)
    found = _made(name).directions(heard(rng, u)[None])
    assert found.valid.sum() == 2
    assert errors(u, found.u[0][found.valid[0]]).max() < 2
    deviation = np.degrees(np.sqrt(found.R[0, :2, 1, 1]))
    assert (deviation > 0.02).all()
    assert (deviation < 2).all()


@pytest.mark.parametrize("name", ["cumulant-peaks", "gls", "cumulant-gls"])
def test_four_sources_are_found_in_correlated_noise(name):
    rng = np.random.default_rng(2)
    u = np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
    noise = "non-uniform" if name == "gls" else "correlated"
    found = _made(name, order="given", sources=4).directions(heard(rng, u, noise=noise)[None])
    assert errors(u, found.u[0][found.valid[0]]).max() < 6


@pytest.mark.parametrize("name", _NAMES)
def test_noise_alone_and_silence_have_no_direction(name):
    rng = np.random.default_rng(3)
    frames = np.stack([heard(rng, np.zeros((0, 3)), 4000), np.zeros((4000, 4))])
    found = _made(name).directions(frames)
    assert not found.valid.any()
    assert np.isfinite(found.u).all()
    assert np.isfinite(found.R).all()


@pytest.mark.parametrize("name", _NAMES)
def test_a_frame_counts_for_itself(name):
    rng = np.random.default_rng(4)
    frames = np.stack([heard(rng, spread(rng, m, 60), 3000) for m in (1, 2)])
    frames.flags.writeable = False
    both = _made(name).directions(frames)
    for k in range(2):
        alone = _made(name).directions(frames[k : k + 1])
        for a, b in zip(both, alone, strict=True):
            np.testing.assert_array_equal(a[k], b[0])


def test_one_source_without_noise_is_exact():
    rng = np.random.default_rng(5)
    u = spread(rng, 1, 0)
    samples = heard(rng, u, 2000, 200.0)[None]
    for name in _NAMES:
        found = _made(name).directions(samples)
        assert errors(u, found.u[0][found.valid[0]]).max() < 0.1, name


def test_the_covariance_of_angles_widens_towards_the_pole():
    rng = np.random.default_rng(6)
    for elevation in (0.0, 1.2):
        u = np.array([[np.cos(elevation), 0.0, np.sin(elevation)]])
        found = _made("gls", order="given", sources=1).directions(heard(rng, u)[None])
        R = found.R[0, 0]
        assert np.sqrt(R[0, 0]) * np.cos(angles(u[0])[1]) == pytest.approx(np.sqrt(R[1, 1]), rel=0.5)


@pytest.mark.parametrize(
    ("name", "table"),
    [
        ("gls", {"noise": "white"}),
        ("gls", {"order": "many"}),
        ("gls", {"most": 9}),
        ("cumulant-peaks", {"most": 0}),
        ("cumulant-peaks", {"order": "given", "sources": 7}),
        ("covariance-peaks", {"most": 3}),
    ],
)
def test_parameters_that_make_no_sense_are_refused(name, table):
    with pytest.raises(Exception, match=r"is needed|one of"):
        _made(name, **table)
