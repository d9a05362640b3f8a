"""Cumulants: unbiased by enumeration, against SciPy, and what they owe to a vector sensor's geometry."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstat
from vector_sources import NOISES, heard, spread

from sonobench.signal.cumulants import (
    DEAD,
    LIVE,
    PAIRS,
    QUADRUPLES,
    covariance_matrix,
    distinct_matrix,
    full_matrix,
    live_matrix,
    moments,
    products,
    quartics,
)
from sonobench.signal.direction_fit import moments_of

seeds = st.integers(0, 2**32 - 1)


def _population(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cumulants (35,) and covariances (10,) of the uniform distribution over points (k, 4)."""
    y = points - points.mean(axis=0)
    R = y.T @ y / len(y)
    fourth = [np.mean(np.prod(y[:, q], axis=1)) for q in QUADRUPLES]
    split = [R[i, j] * R[k, l] + R[i, k] * R[j, l] + R[i, l] * R[j, k] for i, j, k, l in QUADRUPLES]
    return np.array(fourth) - split, np.array([R[i, j] for i, j in PAIRS])


@pytest.mark.parametrize(("mean", "n"), [("zero", 4), ("unknown", 5)])
def test_the_average_over_all_samples_that_can_be_drawn_is_the_cumulant_of_the_population(mean, n):
    points = np.random.default_rng(0).normal(size=(3, 4))
    points[2] = -points[:2].sum(axis=0) if mean == "zero" else points[2]
    every = np.array([points[list(drawn)] for drawn in product(range(3), repeat=n)])
    found = moments(every, mean)
    cumulant, covariance = _population(points)
    np.testing.assert_allclose(found.cumulant.mean(axis=0), cumulant, atol=1e-12)
    np.testing.assert_allclose(found.covariance.mean(axis=0), covariance, atol=1e-12)


def test_of_one_channel_they_are_k_statistics():
    y = np.random.default_rng(1).exponential(size=(1, 50, 4))
    found = moments(y)
    for c in range(4):
        k = QUADRUPLES.tolist().index([c] * 4)
        assert found.cumulant[0, k] == pytest.approx(kstat(y[0, :, c], 4), rel=1e-10)


@given(seeds)
def test_products_of_two_directions_are_the_square_of_theirs(seed):
    a, b = np.random.default_rng(seed).normal(size=(2, 4))
    assert products(a) @ products(b) == pytest.approx((a @ b) ** 2)


def test_the_distinct_matrix_has_the_eigenvalues_of_the_full_one():
    cumulant = np.random.default_rng(2).normal(size=35)
    full, distinct = full_matrix(cumulant), distinct_matrix(cumulant)
    values = np.sort(np.abs(np.linalg.eigvalsh(full)))
    np.testing.assert_allclose(values[6:], np.sort(np.abs(np.linalg.eigvalsh(distinct))), atol=1e-12)
    np.testing.assert_allclose(values[:6], 0, atol=1e-12)
    b = np.kron(np.arange(4.0), np.arange(4.0))
    np.testing.assert_allclose(full_matrix(quartics(np.arange(4.0))), np.outer(b, b))


@given(seeds)
def test_no_source_reaches_the_dead_direction(seed):
    u = spread(np.random.default_rng(seed), 3, 0)
    a = np.concatenate([np.ones((3, 1)), u], axis=1)
    np.testing.assert_allclose(products(a) @ DEAD, 0, atol=1e-14)
    cumulant = np.array([1.0, -2.0, 0.5]) @ quartics(a)
    b = products(a) @ LIVE
    np.testing.assert_allclose(live_matrix(cumulant), b.T @ np.diag([1.0, -2.0, 0.5]) @ b, atol=1e-12)


@pytest.mark.parametrize("noise", sorted(NOISES))
def test_gaussian_noise_of_any_covariance_leaves_them_alone(noise):
    rng = np.random.default_rng(3)
    u = spread(rng, 2, 40)
    found = moments(heard(rng, u, 40_000, 3.0, noise)[None], error=True)
    off = found.cumulant[0] - moments_of(u, np.full(2, -1.2), np.ones(2))[:35]
    assert np.mean(off**2 / np.diag(found.error[0])[:35]) < 3


@pytest.mark.parametrize("mean", ["zero", "unknown"])
def test_the_sampling_covariance_is_the_scatter_of_many_frames(mean):
    rng = np.random.default_rng(4)
    mix = rng.normal(size=(4, 4))
    frames = rng.uniform(-1, 1, (400, 400, 4)) @ mix + (mean == "unknown")
    found = moments(frames, mean, error=True)
    scatter = np.cov(np.concatenate([found.cumulant, found.covariance], axis=1).T)
    told = found.error.mean(axis=0)
    np.testing.assert_allclose(np.diag(told), np.diag(scatter), rtol=0.35)
    scale = np.sqrt(np.outer(np.diag(told), np.diag(told)))
    np.testing.assert_allclose(told / scale, scatter / scale, atol=0.25)


def test_samples_that_repeat_err_more():
    y = np.random.default_rng(5).uniform(-1, 1, (1, 4000, 4))
    once, held = moments(y, error=True), moments(np.repeat(y, 4, axis=1), error=True)
    ratio = np.diag(held.error[0]) / np.diag(once.error[0])
    np.testing.assert_allclose(ratio, 1.0, rtol=0.25)  # four times the samples, no more information


def test_a_frame_counts_for_itself_whatever_its_type_and_layout():
    y = np.random.default_rng(6).normal(size=(3, 500, 4)).astype(np.float32)
    y.flags.writeable = False
    whole = moments(y, error=True)
    for k in range(3):
        alone = moments(np.asfortranarray(y[k : k + 1], np.float64), error=True)
        for a, b in zip(whole, alone, strict=True):
            np.testing.assert_array_equal(a[k], b[0])


def test_covariances_are_those_of_numpy():
    y = np.random.default_rng(7).normal(size=(1, 60, 4)) + 3
    np.testing.assert_allclose(covariance_matrix(moments(y).covariance)[0], np.cov(y[0].T), atol=1e-12)


@pytest.mark.parametrize("shape", [(5, 4), (1, 3, 4), (1, 9, 3)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(ValueError, match="are needed"):
        moments(np.zeros(shape))


def test_silence_has_none():
    found = moments(np.zeros((1, 100, 4)), error=True)
    assert not found.cumulant.any()
    assert not found.error.any()
