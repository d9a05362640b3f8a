"""The compiled loops against the same in NumPy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_linear import Position, frozen, mixture, scan, setup

from sonobench.filtering import mixture_kernels as kernels
from sonobench.filtering.gaussian import definite, gain, log_gaussian, symmetric
from sonobench.filtering.mixture import merge, prune, take
from sonobench.filtering.phd import Moments, correct
from sonobench.types import Space

SPACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")


def spd(rng, *shape):
    A = rng.standard_normal((*shape, shape[-1]))
    return A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(shape[-1])


def locked(*arrays):
    for a in arrays:
        a.flags.writeable = False
    return arrays


def shares_in_numpy(joint, log_clutter):
    evidence = np.logaddexp(np.logaddexp.reduce(joint, axis=0), log_clutter)
    return np.exp(joint - np.where(np.isneginf(evidence), 0.0, evidence))


@pytest.mark.parametrize("each", [True, False], ids=["a noise a row", "one noise"])
@pytest.mark.parametrize("units", [1.0, 1e-4])
def test_densities_shares_and_conditioning_are_numpys(each, units):
    rng = np.random.default_rng(1)
    J, n, dz, d = 7, 5, 3, 4
    residual, cross = units * rng.standard_normal((J, n, dz)), units * rng.standard_normal((J, d, dz))
    S = units**2 * spd(rng, J, n if each else 1, dz)
    m, P, log_prior = rng.standard_normal((J, d)), spd(rng, J, d), np.log(rng.random(J))
    log_kappa = np.log(rng.random(n)) - 3 * np.log(units)
    locked(residual, cross, S, m, P)
    log_g = np.empty((J, n))
    assert kernels.log_densities(residual, S, log_g)
    np.testing.assert_allclose(log_g, log_gaussian(residual, S), rtol=1e-12)
    w = log_g + log_prior[:, None]
    want = shares_in_numpy(w, log_kappa)
    kernels.share(w, log_kappa)
    np.testing.assert_allclose(w, want, rtol=1e-12)
    K = gain(cross[:, None], S)
    mean = m[:, None] + (K @ residual[..., None])[..., 0]
    cov = np.broadcast_to(symmetric(P[:, None] - K @ np.swapaxes(cross[:, None], -1, -2)), (J, n, d, d))
    above = np.median(w)
    got = kernels.conditioned(w, m, P, residual, S, cross, above)
    stay = (w > above).T
    assert 0 < stay.sum() < J * n
    for a, b in zip(got[:3], (w, mean, cov), strict=True):
        np.testing.assert_allclose(a, np.swapaxes(b, 0, 1)[stay], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(got[3], np.tile(np.arange(J), (n, 1))[stay])


def test_shares_of_what_is_impossible_are_zero_not_nan():
    w = np.array([[-np.inf, 0.0, -np.inf], [-np.inf, -np.inf, -np.inf]])
    kernels.share(w, np.array([-np.inf, -np.inf, 0.0]))
    np.testing.assert_array_equal(w, [[0, 1, 0], [0, 0, 0]])


def merged_in_numpy(mixture, distance):
    mix = take(mixture, np.argsort(-mixture.w, kind="stable"))
    inverse = np.linalg.inv(definite(mix.P))
    off = mix.m[:, None] - mix.m
    near = np.einsum("ija,iab,ijb->ij", off, inverse, off) <= distance**2
    label, groups = np.full(len(mix.w), -1), 0
    while (label < 0).any():
        j = np.flatnonzero(label < 0)[0]
        label[near[:, j] & (label < 0) & (mix.mode == mix.mode[j])] = groups
        groups += 1
    out = []
    for g in range(groups):
        w, m, P, _ = take(mix, label == g)
        mean = np.average(m, axis=0, weights=w)
        out.append((w.sum(), mean, np.average(P + np.einsum("ia,ib->iab", m - mean, m - mean), axis=0, weights=w)))
    return [np.array(a) for a in zip(*out, strict=True)]


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.integers(2, 60), st.floats(0.1, 4.0))
def test_merging_is_numpys(seed, n, distance):
    mix = mixture(np.random.default_rng(seed), n, modes=2)
    for a, b in zip(merge(mix, distance, SPACE), merged_in_numpy(mix, distance), strict=False):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(0, 6), st.floats(1e-12, 0.5))
def test_leaving_light_components_out_is_pruning(seed, n, rows, above):
    rng = np.random.default_rng(seed)
    mix, bound = frozen(mixture(rng, n)), Position(clutter=3.0).bind(SPACE, setup())
    H = bound.H()
    moments, heard = Moments(mix.m @ H.T, H @ mix.P @ H.T, mix.P @ H.T), scan(0.0, rng.standard_normal((rows, 2)))
    want = prune(correct(mix, moments, heard, bound, 0), above)
    got = correct(mix, moments, heard, bound, 0, above)
    assert all(np.array_equal(a, b) for a, b in zip(got, want, strict=True))


def test_covariances_that_cannot_be_inverted_are_refused():
    rng = np.random.default_rng(2)
    mix = mixture(rng, 3)
    nothing = Position(std=0.0).bind(SPACE, setup())
    flat = Moments(mix.m[:, :2], np.zeros((3, 2, 2)), np.zeros((3, 4, 2)))
    with pytest.raises(ValueError, match="noise above zero"):
        correct(mix, flat, scan(0.0, rng.standard_normal((2, 2))), nothing, 0)
    with pytest.raises(ValueError, match="not positive definite"):
        merge(mix._replace(P=-mix.P), 2.0, SPACE)
