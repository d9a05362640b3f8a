"""Covariances, noise, the maximiser on the sphere, and first-order errors."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vector_snapshots import NOISE, SOURCE, UNEQUAL, Z, model, sample_covariances, snapshots

from sonobench.errors import InputError
from sonobench.filtering.bounds import direction_information, least_msae
from sonobench.geometry import angles, unit_vector
from sonobench.signal import vector_sensor as vs
from sonobench_plugins.direction.intensity import flowing

_GRID = unit_vector(np.stack(np.meshgrid(np.linspace(-np.pi, np.pi, 181), np.linspace(-np.pi / 2, np.pi / 2, 91)), axis=-1).reshape(-1, 2))


def _value(A: np.ndarray, b: np.ndarray, u: np.ndarray) -> np.ndarray:
    return np.asarray(np.einsum("...i,ij,...j->...", u, A, u) + 2 * u @ b)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0.0, 1e-14, 1e-6, 0.1, 1.0, 1e6]))
def test_the_maximiser_on_the_sphere_is_above_a_grid_and_stationary(seed: int, weight: float) -> None:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((3, 3))
    A, b = root + root.T, weight * rng.standard_normal(3)
    u = vs.maximiser(A, b)
    scale = np.abs(A).max() + np.abs(b).max()
    assert np.linalg.norm(u) == pytest.approx(1.0, abs=1e-12)
    assert _value(A, b, u) >= _value(A, b, _GRID).max() - 1e-12 * scale
    slope = A @ u + b
    assert np.allclose(slope - (u @ slope) * u, 0.0, atol=1e-9 * scale)


@pytest.mark.parametrize("beta", [0.0, 1e-300, 1e-18, -1e-9])
def test_the_maximiser_survives_the_hard_case_in_which_b_has_nothing_along_the_highest_eigenvector(beta: float) -> None:
    A, b = np.diag([1.0, 2.0, 5.0]), np.array([0.8, 1.2, beta])
    u = vs.maximiser(A, b)
    x, y = 0.8 / 4.0, 1.2 / 3.0
    assert np.allclose(np.abs(u), [x, y, np.sqrt(1 - x * x - y * y)], atol=1e-7)
    assert u[2] * beta >= 0.0
    assert np.allclose(vs.maximiser(np.zeros((3, 3)), np.array([0.0, -2.0, 0.0])), [0.0, -1.0, 0.0])
    assert np.linalg.norm(vs.maximiser(np.eye(3), np.zeros(3))) == pytest.approx(1.0)


def test_the_maximiser_of_many_is_that_of_each() -> None:
    rng = np.random.default_rng(0)
    root = rng.standard_normal((4, 5, 3, 3))
    A, b = root + np.swapaxes(root, -1, -2), rng.standard_normal((4, 5, 3))
    whole = vs.maximiser(A, b)
    assert np.allclose(whole, [[vs.maximiser(A[i, j], b[i, j]) for j in range(5)] for i in range(4)], atol=1e-13)


@pytest.mark.parametrize("rule", ["moment", "eigen", "diagonal"])
def test_an_exact_covariance_shows_its_noise(rule: vs.Noise) -> None:
    noise = UNEQUAL if rule == "diagonal" else NOISE
    assert np.allclose(vs.noise_variances(model(noise=noise), rule), noise, rtol=1e-4)
    silent = vs.noise_variances(np.zeros((2, 4, 4)), rule)
    assert silent.shape == (2, 4)
    assert (silent > 0).all()


def test_the_eigen_rule_finds_the_noise_beside_two_sources() -> None:
    C = model() + model(np.radians([-70.0, 10.0]), 2.0, np.zeros(4))
    assert np.allclose(vs.noise_variances(C, "eigen", sources=2), NOISE)


def test_the_closed_form_of_the_error_is_least_at_the_best_weight_and_there_the_bound() -> None:
    alpha = np.linspace(0, 1, 1001)
    errors = vs.msae(alpha, SOURCE, 1.5, 0.5, 8000)
    best = vs.best_alpha(NOISE)
    assert alpha[np.argmin(errors)] == pytest.approx(best, abs=1e-3)
    bound = np.linalg.inv(direction_information(Z, SOURCE, np.diag(NOISE), 8000))
    assert vs.msae(best, SOURCE, 1.5, 0.5, 8000) == pytest.approx(np.trace(bound), rel=1e-12)
    assert least_msae(SOURCE, 1.5, 0.5, 8000) == pytest.approx(np.trace(bound), rel=1e-12)


def test_the_fit_is_the_likeliest_and_states_its_sensitivity() -> None:
    """No change of direction or powers raises the likelihood; moving C moves the fit as M says."""
    C = sample_covariances(np.random.default_rng(2), 1, 500, model(noise=UNEQUAL))[0]
    fit = vs.fitted(C, steps=12)

    def likelihood(u: np.ndarray, powers: np.ndarray) -> float:
        a = np.concatenate([[1.0], u / np.linalg.norm(u)])
        S = powers[0] * np.outer(a, a) + np.diag(powers[1:])
        return float(-np.linalg.slogdet(S)[1] - np.trace(np.linalg.solve(S, C)))

    powers = np.concatenate([[fit.source], fit.noise])
    best = likelihood(fit.u, powers)
    for step in 1e-3 * np.random.default_rng(3).standard_normal((60, 8)):
        assert likelihood(fit.u + step[:3], powers * np.exp(step[3:])) <= best + 1e-9
    exact = model(noise=UNEQUAL)
    change = 1e-6 * vs.symmetric(np.random.default_rng(4).standard_normal((4, 4)))
    moved, still = vs.fitted(exact + change, steps=12), vs.fitted(exact, steps=12)
    predicted = np.einsum("aij,ij->a", still.M, change)
    assert np.allclose(vs.axes(still.u) @ (moved.u - still.u), predicted[:2], rtol=1e-3, atol=1e-9)
    assert np.allclose(np.log(moved.noise / still.noise), predicted[3:], rtol=1e-2, atol=1e-8)


def test_a_fit_of_something_else_is_finite_and_no_less_likely_than_the_moments() -> None:
    rng = np.random.default_rng(5)
    root = rng.standard_normal((200, 4, 4))
    C = root @ np.swapaxes(root, 1, 2)
    fit = vs.fitted(C)
    assert np.isfinite(fit.M).all()
    assert (fit.noise > 0).all()
    assert np.allclose(np.linalg.norm(fit.u, axis=-1), 1.0)


def test_residuals_of_blocks_and_the_plug_in_covariance_agree_on_average() -> None:
    x = snapshots(np.random.default_rng(6), 300, 2000)
    plug, rest = (vs.found(x, flowing, how, 20) for how in ("plug-in", "residuals"))
    assert plug.R is not None
    assert rest.R is not None
    assert np.allclose(np.mean(rest.R, axis=(0, 1)), np.mean(plug.R, axis=(0, 1)), rtol=0.12, atol=3e-6)
    errors = angles(plug.u[:, 0]) - Z
    assert np.allclose(np.cov(errors.T), np.mean(plug.R, axis=(0, 1)), rtol=0.25, atol=3e-5)
    assert vs.found(x, flowing, "none", 20).R is None


def test_frames_too_short_for_residuals_are_refused() -> None:
    with pytest.raises(InputError, match="60 samples into 20 blocks"):
        vs.found(snapshots(np.random.default_rng(0), 1, 60), flowing, "residuals", 20)
