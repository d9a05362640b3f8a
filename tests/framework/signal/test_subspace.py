"""Subspaces of cumulants and covariances: what they resolve, order rules, spectra."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vector_sources import errors, heard, spread

from sonobench.geometry import angles
from sonobench.signal.cumulants import Moments, moments
from sonobench.signal.direction_fit import moments_of
from sonobench.signal.subspace import Order, found_peaks, grid, peaks, slopes, spectrum, steering, subspace
from sonobench.sphere import across, stepped

_WIDTH = np.radians(1.0)


def _given(m: int) -> Order:
    return Order("given", m, 0.1, 0.003, 8)


def exact(u: np.ndarray, kappa: np.ndarray | None = None) -> Moments:
    """The moments of sources without error, under equal noise."""
    kappa = np.full(len(u), -1.2) if kappa is None else kappa
    y = moments_of(u, kappa, np.ones(len(u)))
    y[35 + np.array([0, 4, 7, 9])] += 0.1
    return Moments(y[None, :35], y[None, 35:], 1e-6 * np.eye(45)[None])


@pytest.mark.parametrize("m", range(1, 7))
def test_exact_cumulants_resolve_up_to_six_sources(m):
    rng = np.random.default_rng(m)
    for _ in range(5):
        u = spread(rng, m, 30)
        found = peaks(subspace(exact(u, rng.choice([-1.2, 2.0], m)), 0, True, _given(m)), 12)
        assert errors(u, found.u[found.null < 1e-10]).max() < 1e-3
        assert (found.null < 1e-10).sum() == m


def test_a_seventh_source_brings_a_ghost():
    u = spread(np.random.default_rng(7), 7, 30)
    found = peaks(subspace(exact(u), 0, True, _given(7)), 12)
    assert errors(u, found.u[found.null < 1e-10]).max() < 1e-3
    assert (found.null < 1e-10).sum() == 8


def test_exact_covariances_resolve_two_sources_and_no_third():
    u = spread(np.random.default_rng(8), 3, 40)
    found = peaks(subspace(exact(u[:2]), 0, False, _given(2)), 6)
    assert errors(u[:2], found.u[found.null < 1e-10]).max() < 1e-3
    assert (found.null < 1e-10).sum() == 2
    assert subspace(exact(u), 0, False, _given(3)).m == 2


@given(st.integers(0, 2**32 - 1), st.sampled_from([4, 10]))
def test_slopes_are_the_differences_of_steering(seed, b):
    u = spread(np.random.default_rng(seed), 1, 0)
    step = 1e-6
    for axis in range(2):
        one = np.zeros((1, 2))
        one[0, axis] = step
        difference = (steering(stepped(u, one), b) - steering(stepped(u, -one), b)) / (2 * step)
        np.testing.assert_allclose(slopes(u, b)[..., axis], difference, atol=1e-8)


def test_tangents_are_orthonormal_also_at_the_poles():
    u = np.array([[0.0, 0, 1], [0, 0, -1], [0.6, 0, 0.8]])
    full = np.concatenate([u[:, :, None], across(u)], axis=-1)
    np.testing.assert_allclose(full.swapaxes(1, 2) @ full, np.tile(np.eye(3), (3, 1, 1)), atol=1e-14)


@pytest.mark.parametrize(("rule", "m"), [("threshold", 3), ("gap", 2), ("given", 4)])
def test_order_rules_read_sorted_magnitudes(rule, m):
    magnitudes = np.array([1.0, 0.9, 0.2, 0.08, 0.05, 0.03, 0.02, 0.01, 0.01])
    assert Order(rule, 4, 0.1, 0.003, 6).count(magnitudes, np.zeros(7), 6) == m
    assert Order(rule, 4, 0.1, 0.003, 6).count(magnitudes, np.zeros(7), 1) == 1


@pytest.mark.parametrize("m", [0, 1, 2, 3])
def test_what_error_explains_is_no_source(m):
    rng = np.random.default_rng(m)
    told = [
        subspace(moments(heard(rng, spread(rng, m, 40), 5000)[None], error=True), 0, True, Order("error", 0, 0.1, 0.003, 6)).m
        for _ in range(8)
    ]
    assert np.mean(np.array(told) == m) >= 0.8


@pytest.mark.parametrize(("cumulants", "m"), [(True, 1), (True, 3), (False, 2)])
def test_sources_miss_the_subspace_by_as_much_as_is_expected(cumulants, m):
    rng = np.random.default_rng(m)
    ratio = []
    for _ in range(25):
        u = spread(rng, m, 40)
        one = subspace(moments(heard(rng, u, 4000)[None], error=True), 0, cumulants, _given(m))
        b = steering(u, len(one.noise))
        ratio += list(((b @ one.noise) * b).sum(axis=1) / ((b @ one.spread) * b).sum(axis=1) / ((9 if cumulants else 4) - m))
    assert 0.7 < np.mean(ratio) < 1.4


def test_order_rules_that_make_no_sense_are_refused():
    with pytest.raises(ValueError, match="'gap' or 'given'"):
        Order("many", 1, 0.1, 0.003, 6)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="threshold"):
        Order("gap", 1, 0.0, 0.003, 6)


@pytest.mark.parametrize(("cumulants", "m"), [(True, 0), (True, 1), (True, 4), (False, 1), (False, 2)])
def test_a_spectrum_integrates_to_the_number_of_sources(cumulants, m):
    rng = np.random.default_rng(11)
    found = moments(heard(rng, spread(rng, m, 40))[None], error=True)
    field = spectrum(subspace(found, 0, cumulants, _given(m)), _WIDTH)
    z = np.stack(np.meshgrid(np.radians(np.arange(-180, 180, 0.5)), np.radians(np.arange(-89.75, 90, 0.5)), indexing="ij"), axis=-1)
    cells = field.at(z[:, :, None], np.array([0]))[..., 0] * np.cos(z[..., 1]) * np.radians(0.5) ** 2
    assert cells.sum() == pytest.approx(m, rel=0.03)


def test_a_spectrum_is_the_formula_of_its_type():
    rng = np.random.default_rng(12)
    found = moments(heard(rng, spread(rng, 2, 40))[None], error=True)
    u = grid()[0][::100]
    for cumulants, b in ((True, 10), (False, 4)):
        field = spectrum(subspace(found, 0, cumulants, _given(2)), _WIDTH)
        s = steering(u, b)
        ratio = ((s @ field.noise[0]) * s).sum(axis=1) / ((s @ field.spread[0]) * s).sum(axis=1)
        np.testing.assert_allclose(
            field.at(angles(u)[:, None], np.array([0]))[:, 0], field.height[0] * (1 + ratio) ** -field.power[0], rtol=1e-9
        )


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_peaks_turn_with_the_sources(seed):
    rng = np.random.default_rng(seed)
    samples = heard(rng, spread(rng, 2, 40), 4000)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = np.concatenate([samples[:, :1], samples[:, 1:] @ turn.T], axis=1)
    one, other = (found_peaks(moments(s[None], error=True), True, _given(2)).u[0, :2] for s in (samples, turned))
    assert errors(one @ turn.T, other).max() < 1e-3
