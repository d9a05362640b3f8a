"""Generalised least squares of directions."""

from __future__ import annotations

import numpy as np
import pytest
from vector_sources import errors, heard, spread

from sonobench.geometry import angles
from sonobench.signal.cumulants import Moments, moments, quartics
from sonobench.signal.direction_fit import explained, fit_directions, fitted_spectrum, moments_of, pursued, random_starts
from sonobench.sphere import across, stepped


def _exact(u: np.ndarray) -> tuple[Moments, np.ndarray, np.ndarray]:
    kappa, power = -np.linspace(0.5, 1.5, len(u)), np.linspace(1.0, 2.0, len(u))
    y = moments_of(u, kappa, power)
    y[35 + np.array([0, 4, 7, 9])] += [0.1, 0.2, 0.3, 0.4]
    return Moments(y[None, :35], y[None, 35:], 1e-6 * np.eye(45)[None]), kappa, power


def test_moments_of_sources_are_sums_of_products():
    u = spread(np.random.default_rng(0), 3, 20)
    a = np.concatenate([np.ones((3, 1)), u], axis=1)
    found = moments_of(u, np.array([1.0, 2, 3]), np.array([4.0, 5, 6]))
    np.testing.assert_allclose(found[:35], np.array([1.0, 2, 3]) @ quartics(a))
    R = (a * np.array([4.0, 5, 6])[:, None]).T @ a
    np.testing.assert_allclose(found[35:], R[np.triu_indices(4)])


@pytest.mark.parametrize("m", [1, 2, 3, 5])
def test_exact_moments_give_exact_directions_powers_and_cumulants(m):
    u = spread(np.random.default_rng(m), m, 35)
    found, kappa, power = _exact(u)
    near = stepped(u, 0.1 * np.random.default_rng(9).normal(size=(m, 2)))
    fit = fit_directions(found, 0, "diagonal", near[None])
    assert errors(u, fit.u).max() < 1e-3
    np.testing.assert_allclose(fit.cumulant, kappa, rtol=1e-4)
    np.testing.assert_allclose(fit.power, power, rtol=1e-4)
    assert explained(fit) > 0.999


def test_one_of_the_starts_is_enough():
    u = spread(np.random.default_rng(1), 3, 40)
    found, *_ = _exact(u)
    fit = fit_directions(found, 0, "any", np.concatenate([random_starts(10, 3, 0), pursued(found, 0, "any", 3)[None]]))
    assert errors(u, fit.u).max() < 1e-3
    assert fit.power is None


def test_the_covariance_is_that_of_the_error():
    rng = np.random.default_rng(2)
    square = []
    for _ in range(25):
        u = spread(rng, 2, 40)
        found = moments(heard(rng, u, 4000)[None], error=True)
        fit = fit_directions(found, 0, "diagonal", u[None])
        off = np.einsum("mi,mij->mj", u - fit.u, across(fit.u))
        square += list(np.einsum("mi,mij,mj->m", off, np.linalg.inv(fit.R), off))
    assert 1.2 < np.mean(square) < 3.2  # chi-square of two degrees: 2 ± .3


def test_too_few_sources_leave_more_than_error_explains():
    rng = np.random.default_rng(3)
    u = spread(rng, 3, 40)
    found = moments(heard(rng, u)[None], error=True)
    assert explained(fit_directions(found, 0, "diagonal", u[None])) > 1e-3
    assert explained(fit_directions(found, 0, "diagonal", u[None, :2])) < 1e-6


def test_random_starts_are_the_same_every_time_and_unit():
    np.testing.assert_array_equal(random_starts(3, 4, 5), random_starts(3, 4, 5))
    np.testing.assert_allclose(np.linalg.norm(random_starts(3, 4, 5), axis=-1), 1.0)


def test_a_fitted_spectrum_peaks_where_the_fit_is():
    rng = np.random.default_rng(4)
    u = spread(rng, 4, 40)
    found = moments(heard(rng, u)[None], error=True)
    fit = fit_directions(found, 0, "diagonal", u[None])
    field = fitted_spectrum(fit, np.radians(1.0))
    at = field.at(angles(fit.u)[:, None], np.array([0]))[:, 0]
    beside = field.at(angles(stepped(fit.u, np.full((4, 2), 0.1)))[:, None], np.array([0]))[:, 0]
    np.testing.assert_allclose(at, field.height[0], rtol=1e-6)
    assert (beside < 0.3 * at).all()


def test_without_sampling_covariance_or_start_a_fit_is_refused():
    found, *_ = _exact(spread(np.random.default_rng(5), 1, 0))
    with pytest.raises(ValueError, match="at least one start"):
        fit_directions(found, 0, "any", np.zeros((0, 1, 3)))
    with pytest.raises(ValueError, match="error=True"):
        fit_directions(found._replace(error=None), 0, "any", random_starts(1, 1, 0))
