"""The compiled loops over particles against the same in NumPy."""

import numpy as np
import pytest

from sonobench.filtering import particle_kernels as kernels
from sonobench.filtering.gaussian import log_gaussian
from sonobench.filtering.phd import log_densities


@pytest.mark.parametrize("spread", [1.0, 300.0])
def test_log_shares_and_their_sums_are_numpys(spread):
    rng = np.random.default_rng(0)
    joint, log_clutter, missed = spread * rng.standard_normal((40, 6)), rng.standard_normal(6), spread * rng.standard_normal(40)
    joint[:, 2] = log_clutter[2] = -np.inf  # a row that nothing explains
    joint[3], missed[3] = -np.inf, -np.inf  # a particle without weight
    evidence = np.logaddexp(np.logaddexp.reduce(joint, axis=0), log_clutter)
    want = joint - np.where(np.isneginf(evidence), 0.0, evidence)
    log_w, share, after = rng.standard_normal(40), np.full((6, 40), np.nan), missed.copy()
    got = np.ascontiguousarray((joint - log_w[:, None]).T)
    kernels.log_share(got, log_w, log_clutter, share)
    np.testing.assert_allclose(got.T, want, rtol=1e-13, atol=1e-12)
    np.testing.assert_allclose(share.T, np.exp(want), rtol=1e-11, atol=1e-24)
    kernels.add_logs(after, got, share.sum(axis=0))
    np.testing.assert_allclose(after, np.logaddexp.reduce(np.column_stack([missed, want]), axis=1), rtol=1e-13, atol=1e-12)


def test_masses_within_a_radius_are_numpys():
    rng = np.random.default_rng(1)
    x, w, centres = rng.random((200, 3)), rng.random(200), rng.random((7, 3))
    got = np.full(7, np.nan)
    kernels.masses(x, w, np.ascontiguousarray(centres.T), 0.25, got)
    near = np.sum((x[:, None] - centres) ** 2, axis=-1) <= 0.25
    np.testing.assert_allclose(got, w @ near, rtol=1e-13)


@pytest.mark.parametrize("noises", [1, 5], ids=["one noise", "a noise a row"])
def test_particles_share_the_noise(noises):
    rng = np.random.default_rng(2)
    A = rng.standard_normal((1, noises, 3, 3))
    S, residual = A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(3), rng.standard_normal((9, 5, 3))
    got = np.empty((5, 9))
    assert kernels.along(np.ascontiguousarray(residual.transpose(1, 2, 0)), S, got)
    np.testing.assert_allclose(log_densities(residual, S), log_gaussian(residual, S), rtol=1e-11)
    np.testing.assert_allclose(got.T, log_gaussian(residual, S), rtol=1e-11)
    assert not kernels.along(np.ascontiguousarray(residual.transpose(1, 2, 0)), np.zeros_like(S), got)


def test_moments_are_numpys_and_take_nothing_from_particles_without_weight():
    rng = np.random.default_rng(4)
    x, w = rng.standard_normal((50, 3)) + 5, rng.random(50) * (rng.random(50) < 0.7)
    mean, cov = np.empty(3), np.empty((3, 3))
    kernels.moments(x, w, mean, cov)
    np.testing.assert_allclose(mean, np.average(x, axis=0, weights=w), rtol=1e-13)
    np.testing.assert_allclose(cov, np.cov(x.T, aweights=w, ddof=0), rtol=1e-12)


def test_edges_are_walked_as_searched():
    rng = np.random.default_rng(5)
    edges = np.cumsum(rng.random(60) * (rng.random(60) < 0.6))
    edges /= edges[-1]
    edges[-1] = 1.0
    at, got = np.sort(np.append(rng.random(80), edges[[3, 20]])), np.empty(82, np.int64)
    kernels.at_edges(edges, at, got)
    np.testing.assert_array_equal(got, np.searchsorted(edges, at, side="right"))
    kernels.at_edges(edges, np.ones(82), got)  # rounded up: there is no edge above
    assert (got == 59).all()
