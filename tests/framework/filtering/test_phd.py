import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from phd_linear import Position, mixture, scan, setup
from scipy.stats import multivariate_normal

from sonobench.errors import InputError
from sonobench.filtering.evidence import rows_of, searched
from sonobench.filtering.phd import Moments, correct, reweigh
from sonobench.filtering.steps import elapsed, survival
from sonobench.types import Detections, Scan, Space

SPACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")


def model(**values):
    return Position(**values).bind(SPACE, setup())


def moments(mix, bound):
    H = bound.H()
    return Moments(mix.m @ H.T, H @ mix.P @ H.T, mix.P @ H.T)


def corrected_one_by_one(mix, z, bound, R):
    """Vo & Ma 2006, eq. 20 to 22, with plain loops: weights (J, 1 + m), means and covariances."""
    H, p_d = bound.H(), bound.of.probability
    kappa = bound.of.clutter / bound.of.area
    w, m, P = [list((1 - p_d) * mix.w)], [list(mix.m)], [list(mix.P)]
    for row in z:
        g = [multivariate_normal(H @ mix.m[j], H @ mix.P[j] @ H.T + R).pdf(row) * mix.w[j] * p_d for j in range(len(mix.w))]
        K = [mix.P[j] @ H.T @ np.linalg.inv(H @ mix.P[j] @ H.T + R) for j in range(len(mix.w))]
        w.append([a / (kappa + sum(g)) for a in g])
        m.append([mix.m[j] + K[j] @ (row - H @ mix.m[j]) for j in range(len(mix.w))])
        P.append([(np.eye(4) - K[j] @ H) @ mix.P[j] for j in range(len(mix.w))])
    return np.array(w), np.array(m), np.array(P)


def sorted_rows(z):
    return z[np.lexsort(z.T)]


def test_corrector_is_the_printed_sum_over_components_and_rows():
    rng = np.random.default_rng(3)
    mix, bound = mixture(rng, 6), model(clutter=3.0)
    z = sorted_rows(rng.standard_normal((4, 2)) * 2)
    got = correct(mix, moments(mix, bound), scan(0.0, z), bound, 0)
    w, m, P = corrected_one_by_one(mix, z, bound, bound.R(0))
    np.testing.assert_allclose(got.w, w.ravel(), rtol=1e-10, atol=1e-300)
    np.testing.assert_allclose(got.m, m.reshape(-1, 4), rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(got.P, P.reshape(-1, 4, 4), rtol=0, atol=1e-12)


def test_a_row_that_brings_its_own_covariance_is_used_with_it():
    rng = np.random.default_rng(4)
    mix, bound = mixture(rng, 3), model(clutter=1.0)
    z, R = rng.standard_normal((1, 2)), np.array([[0.5, 0.2], [0.2, 0.3]])
    got = correct(mix, moments(mix, bound), scan(0.0, z, R=R[None]), bound, 0)
    w, m, _ = corrected_one_by_one(mix, z, bound, R)
    np.testing.assert_allclose(got.w, w.ravel(), rtol=1e-10)
    np.testing.assert_allclose(got.m, m.reshape(-1, 4), rtol=1e-11)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(0, 6), st.floats(0.05, 1.0), st.floats(0, 20))
def test_mass_is_what_was_missed_plus_each_rows_share(seed, n, rows, p_d, clutter):
    rng = np.random.default_rng(seed)
    mix, bound = mixture(rng, n), model(probability=p_d, clutter=clutter)
    got = correct(mix, moments(mix, bound), scan(0.0, rng.standard_normal((rows, 2)) * 3), bound, 0)
    missed, shares = got.w[:n].sum(), got.w[n:].reshape(rows, n).sum(axis=1)
    assert missed == pytest.approx((1 - p_d) * mix.w.sum(), abs=1e-12)
    assert (shares <= 1 + 1e-12).all()
    if clutter == 0:
        np.testing.assert_allclose(shares, 1, rtol=1e-12)


@settings(deadline=None, max_examples=25)
@given(st.permutations(range(5)))
def test_the_order_of_rows_changes_not_a_bit(order):
    rng = np.random.default_rng(5)
    mix, bound = mixture(rng, 4), model(clutter=2.0)
    z, R = rng.standard_normal((5, 2)), np.array([np.eye(2) * s for s in (0.1, 0.2, 0.1, 0.4, 0.5)])
    valid = np.array([[True, True], [True, False], [True, True], [False, True], [True, False]])
    a = correct(mix, moments(mix, bound), scan(0.0, z, R=R, valid=valid), bound, 0)
    p = list(order)
    b = correct(mix, moments(mix, bound), scan(0.0, z[p], R=R[p], valid=valid[p]), bound, 0)
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_a_row_with_a_missing_component_is_the_update_of_its_marginal():
    rng = np.random.default_rng(6)
    mix, bound = mixture(rng, 5), model(clutter=3.0)
    z = rng.standard_normal((1, 2))
    got = correct(mix, moments(mix, bound), scan(0.0, z, valid=[[True, False]]), bound, 0)
    H, kappa = bound.H()[:1], 3.0 / 10.0  # the clutter's density over one side of the area
    g = np.array([multivariate_normal(H @ m, H @ P @ H.T + 0.01).pdf(z[0, 0]) for m, P in zip(mix.m, mix.P, strict=True)])
    np.testing.assert_allclose(got.w[5:], 0.9 * mix.w * g / (kappa + (0.9 * mix.w * g).sum()), rtol=1e-10)
    K = mix.P @ H.T / (H @ mix.P @ H.T + 0.01)
    np.testing.assert_allclose(got.m[5:], mix.m + K[..., 0] * (z[0, 0] - mix.m @ H.T), rtol=1e-11)


def test_what_a_missing_component_holds_does_not_matter_and_a_wholly_missing_row_is_no_row():
    rng = np.random.default_rng(7)
    mix, bound = mixture(rng, 3), model(clutter=3.0)

    def after(value):
        z = np.array([[0.3, value], [value, value]])
        return correct(mix, moments(mix, bound), scan(0.0, z, valid=[[True, False], [False, False]]), bound, 0)

    a, b = after(0.0), after(1e6)
    assert len(a.w) == 6
    assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_particles_are_reweighed_by_the_same_formula():
    rng = np.random.default_rng(8)
    x, w = rng.standard_normal((50, 4)), rng.random(50)
    bound = model(clutter=2.0, std=0.5)
    z = sorted_rows(rng.standard_normal((3, 2)))
    log_w, shares = reweigh(np.log(w), x, bound.h(x, 0)[:, 0], scan(0.0, z), bound, 0)
    g = np.array([multivariate_normal(row, bound.R(0)).pdf(x @ bound.H().T) for row in z]).T
    want = 0.9 * w[:, None] * g / (2.0 / 100 + (0.9 * w[:, None] * g).sum(axis=0))
    np.testing.assert_allclose(shares, want, rtol=1e-10)
    np.testing.assert_allclose(np.exp(log_w), 0.1 * w + want.sum(axis=1), rtol=1e-10)


def test_components_of_a_vanishing_spread_are_particles():
    rng = np.random.default_rng(9)
    mix, bound = mixture(rng, 4), model(clutter=2.0, std=0.7)
    mix = mix._replace(P=np.zeros_like(mix.P))
    frame = scan(0.0, rng.standard_normal((3, 2)))
    got = correct(mix, moments(mix, bound), frame, bound, 0)
    log_w, _ = reweigh(np.log(mix.w), mix.m, mix.m @ bound.H().T, frame, bound, 0)
    np.testing.assert_allclose(got.w.reshape(4, 4).sum(axis=0), np.exp(log_w), rtol=1e-12)


def test_nobody_and_no_clutter_divides_by_nothing():
    from sonobench.filtering.mixture import empty

    bound = model()
    got = correct(empty(4), moments(empty(4), bound), scan(0.0, [[1, 2]]), bound, 0)
    assert len(got.w) == 0


def test_scans_of_another_setup_are_refused():
    with pytest.raises(InputError, match="2 components for sensor 0, which has 3"):
        rows_of(scan(0.0, [[1, 2]]), 0, 3)
    with pytest.raises(InputError, match="1 sensors"):
        searched(scan(0.0, [[1, 2]]), (0, 1))
    two = Detections([[1.0, 2]], [0])
    with pytest.raises(InputError, match="2 sets"):
        rows_of(Scan(0.0, [True], (two, two)), 0, 2)
    with pytest.raises(InputError, match="time order"):
        elapsed(2.0, scan(1.0, []))


def test_survival_composes_over_irregular_steps():
    assert survival(0.9, 0.3, 1.0) * survival(0.9, 0.7, 1.0) == pytest.approx(0.9)
    assert survival(0.9, 0.3, None) == 0.9
    assert survival(0.9, 0.0, 1.0) == 1.0
