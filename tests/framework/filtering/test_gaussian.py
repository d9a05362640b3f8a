import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sonobench.filtering.gaussian import definite, gain, log_degenerate, log_gaussian, root


def spd(rng, *shape):
    A = rng.standard_normal((*shape, shape[-1]))
    return A @ np.swapaxes(A, -1, -2) + 0.1 * np.eye(shape[-1])


def test_log_gaussian_is_scipys_density_for_batches_and_shared_covariances():
    rng = np.random.default_rng(0)
    r, S = rng.standard_normal((5, 7, 3)), spd(rng, 5, 1, 3)
    got = log_gaussian(r, S)
    want = [[multivariate_normal(np.zeros(3), S[i, 0]).logpdf(r[i, j]) for j in range(7)] for i in range(5)]
    np.testing.assert_allclose(got, want, rtol=1e-12)
    np.testing.assert_allclose(log_gaussian(r, S[0, 0])[0], want[0], rtol=1e-12)


def test_log_gaussian_stays_finite_where_the_density_underflows():
    assert log_gaussian(np.array([[1.0]]), np.eye(1) * 1e-10)[0] == pytest.approx(-5e9, rel=1e-6)


def test_a_singular_innovation_is_refused_with_what_to_do():
    with pytest.raises(ValueError, match="noise above zero"):
        log_gaussian(np.zeros((1, 2)), np.zeros((1, 2, 2)))


def test_gain_solves_k_s_equals_cross():
    rng = np.random.default_rng(1)
    cross, S = rng.standard_normal((4, 5, 3)), spd(rng, 4, 3)
    np.testing.assert_allclose(gain(cross, S) @ S, cross, rtol=0, atol=1e-12)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e6])
def test_root_reproduces_definite_semidefinite_and_zero_matrices(scale):
    units = np.array([1.0, 1e-6, 1e3])
    rank_one = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    P = np.stack([np.eye(3), rank_one, np.zeros((3, 3)), np.diag([1.0, 0, 2])]) * np.outer(units, units) * scale
    A = root(P)
    np.testing.assert_allclose(A @ np.swapaxes(A, 1, 2), P, rtol=1e-7, atol=0)


def test_root_of_one_matrix_does_not_depend_on_its_neighbours():
    P = np.array([[2.0, 0.3], [0.3, 1.0]])
    assert np.array_equal(root(np.stack([P, np.zeros((2, 2))]))[0], root(P))


def test_root_refuses_an_indefinite_matrix():
    with pytest.raises(ValueError, match="positive semi-definite"):
        root(np.diag([1.0, -0.1])[None])


def test_definite_adds_a_share_of_the_diagonal_whatever_the_units():
    for scale in (1e-12, 1.0, 1e12):
        P = np.diag([1.0, 1e-6]) * scale
        np.testing.assert_allclose(definite(P, 1e-9) / P.max(), np.diag([1 + 1e-9, 1e-6 + 1e-15]), rtol=1e-6, atol=2e-18)
    np.linalg.cholesky(definite(np.array([[1.0, 1.0], [1.0, 1.0]])))


def test_degenerate_density_is_the_one_on_the_support_and_minus_infinity_off_it():
    direction = np.array([3.0, 4.0]) / 5
    Q = 0.25 * np.outer(direction, direction)
    on, off = direction * 0.7, np.array([-4.0, 3.0]) / 5 * 1e-3
    log = log_degenerate(np.array([on, on + off]), Q, np.ones(2))
    assert log[0] == pytest.approx(multivariate_normal(0, 0.25).logpdf(0.7), rel=1e-12)
    assert log[1] == -np.inf
    np.testing.assert_array_equal(log_degenerate(np.array([[0.0, 0], [0, 1e-3]]), np.zeros((2, 2)), np.ones(2)), [0, -np.inf])
