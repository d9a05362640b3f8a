"""Cramér-Rao bounds against other derivations."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench.filtering.bounds import best_fitting, direction_information, least_msae, posterior_covariances
from sonobench.geometry import unit_vector
from sonobench.sphere import moved, tangents
from sonobench.types import Array

_Z = np.array([0.5, 0.4])
_WHITE = np.diag([1.5, 0.5, 0.5, 0.5])
_GENERAL = np.array([[1.5, 0.3, 0.0, 0.1], [0.3, 0.2, 0.05, 0.0], [0.0, 0.05, 0.6, -0.2], [0.1, 0.0, -0.2, 1.1]])


def _vector(z: Array) -> Array:
    return np.concatenate([[1.0], unit_vector(z)])


def _expected_log_likelihood(step: Array, power: float, noise: Array, true: Array) -> float:
    """Mean log-likelihood of a snapshot from covariance `true` under a model turned by a step."""
    a = _vector(moved(_Z, step))
    model = power * np.outer(a, a) + noise
    return float(-0.5 * (np.linalg.slogdet(model)[1] + np.trace(np.linalg.solve(model, true))))


@pytest.mark.parametrize("noise", [_WHITE, _GENERAL], ids=["white", "general"])
def test_information_is_the_curvature_of_the_mean_log_likelihood(noise: Array) -> None:
    """Second derivation: finite differences of E log p over direction and power, the power eliminated by inverting."""
    power, h = 3.0, 1e-3
    true = power * np.outer(_vector(_Z), _vector(_Z)) + noise

    def at(p: Array) -> float:
        return _expected_log_likelihood(p[:2], power + p[2], noise, true)

    J = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            e, f = h * np.eye(3)[i], h * np.eye(3)[j]
            J[i, j] = -(at(e + f) - at(e - f) - at(f - e) + at(-e - f)) / (4 * h * h)
    eliminated = np.linalg.inv(np.linalg.inv(J)[:2, :2])
    assert np.allclose(direction_information(_Z, power, noise, 1), eliminated, rtol=1e-4, atol=1e-5)


def test_deterministic_information_is_that_of_a_nonlinear_regression() -> None:
    """Second derivation: the full information of direction and all samples, inverted."""
    rng = np.random.default_rng(2)
    s, inverse = rng.standard_normal(6), np.linalg.inv(_GENERAL)
    slope = np.concatenate([np.zeros((2, 1)), tangents(_Z)], axis=1)
    J = np.zeros((8, 8))
    for k, value in enumerate(s):
        G = np.zeros((4, 8))
        G[:, :2], G[:, 2 + k] = value * slope.T, _vector(_Z)
        J += G.T @ inverse @ G
    found = direction_information(_Z, float(np.mean(s**2)), _GENERAL, 6, signal="deterministic")
    assert np.allclose(found, np.linalg.inv(np.linalg.inv(J)[:2, :2]))


def test_for_equal_velocity_noise_the_bound_is_the_least_msae_over_alpha() -> None:
    power, pressure, velocity, n = np.sqrt(10.0), 1.5, 0.5, 8000
    alpha = np.linspace(0, 1, 100001)
    printed = 2 * velocity * (power + alpha**2 * pressure + (1 - alpha) ** 2 * velocity) / (n * power**2)
    assert least_msae(power, pressure, velocity, n) == pytest.approx(printed.min(), rel=1e-8)
    J = direction_information(np.stack([_Z, [2.0, 1.5], [-3.0, -np.pi / 2]]), power, np.diag([pressure, *3 * [velocity]]), n)
    assert np.allclose(np.trace(np.linalg.inv(J), axis1=-2, axis2=-1), printed.min(), rtol=1e-8)


def test_knowing_less_never_bounds_lower_and_samples_of_their_own_tell_more() -> None:
    known, unknown, own = (
        np.trace(np.linalg.inv(direction_information(_Z, 2.0, np.diag([1.0, 0.2, 0.5, 0.9]), 1, **k)))  # type: ignore[arg-type]
        for k in ({}, {"unknown": "diagonal"}, {"signal": "deterministic"})
    )
    assert own < known < unknown


def test_a_most_likely_direction_reaches_the_bound() -> None:
    """2000 draws of 400 snapshots: the scatter of the best of a linearised likelihood, within 6 %."""
    rng, power, n = np.random.default_rng(7), 3.0, 400
    theta = power * np.outer(_vector(_Z), _vector(_Z)) + _GENERAL
    inverse = np.linalg.inv(theta)
    slope = np.concatenate([np.zeros((2, 1)), tangents(_Z)], axis=1)
    changes = [power * (np.outer(d, _vector(_Z)) + np.outer(_vector(_Z), d)) for d in slope] + [np.outer(_vector(_Z), _vector(_Z))]
    J = np.array([[0.5 * n * np.trace(inverse @ a @ inverse @ b) for b in changes] for a in changes])
    y = rng.standard_normal((2000, n, 4)) @ np.linalg.cholesky(theta).T
    sample = np.swapaxes(y, 1, 2) @ y
    score = np.stack([0.5 * np.einsum("ij,kji->k", inverse @ c @ inverse, sample - n * theta) for c in changes], axis=1)
    scatter = np.cov((score @ np.linalg.inv(J).T).T)[:2, :2]
    assert np.allclose(scatter, np.linalg.inv(direction_information(_Z, power, _GENERAL, n)), rtol=0.12, atol=0.06 * scatter.max())


def test_the_posterior_bound_of_a_linear_model_is_the_kalman_filters_covariance() -> None:
    rng, k = np.random.default_rng(1), 5
    F, H = rng.standard_normal((k, 3, 3)), rng.standard_normal((k, 2, 3))
    g = rng.standard_normal((k, 3, 1))
    Q, R = g @ np.swapaxes(g, 1, 2), np.array([[0.5, 0.1], [0.1, 0.3]])
    P, wanted = 2 * np.eye(3), []
    for f, q, h in zip(F, Q, H, strict=True):
        P = f @ P @ f.T + q
        P = np.linalg.inv(np.linalg.inv(P) + h.T @ np.linalg.inv(R) @ h)
        wanted.append(P)
    found = posterior_covariances(2 * np.eye(3), F, Q, H, np.tile(np.linalg.inv(R), (k, 1, 1)))
    assert np.allclose(found, wanted)
    silent = posterior_covariances(2 * np.eye(3), F, Q, H, np.zeros((k, 2, 2)))
    assert np.allclose(silent[0], F[0] @ (2 * np.eye(3)) @ F[0].T + Q[0])


def test_one_motion_that_fits_a_switch_has_its_moments() -> None:
    """Monte Carlo over modes and states: mean and covariance of the next state, within its error."""
    rng = np.random.default_rng(4)
    F, Q = rng.standard_normal((2, 2, 2)), np.stack([0.1 * np.eye(2), 0.4 * np.eye(2)])
    p, m, P = np.array([0.3, 0.7]), np.array([1.0, -0.5]), np.array([[0.5, 0.2], [0.2, 0.3]])
    n = 200000
    x, mode = rng.multivariate_normal(m, P, n), rng.choice(2, n, p=p)
    after = np.einsum("nab,nb->na", F[mode], x) + np.sqrt(np.array([0.1, 0.4])[mode])[:, None] * rng.standard_normal((n, 2))
    mean, noise = best_fitting(F, Q, p, m, P)
    assert np.allclose(after.mean(axis=0), mean @ m, atol=0.02)
    assert np.allclose(np.cov(after.T), mean @ P @ mean.T + noise, atol=0.03)
