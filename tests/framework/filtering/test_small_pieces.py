import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench.errors import SetupError
from sonobench.filtering.kinematics import kinematic_space, position_columns, variances
from sonobench.filtering.particles import Cloud, balls, empty_cloud, join, shared
from sonobench.filtering.points import spread, weighted_moments
from sonobench.filtering.resampling import systematic
from sonobench.types import Space


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 10**6), st.integers(1, 30), st.integers(1, 200))
def test_systematic_draws_each_particle_its_share_rounded_down_or_up(seed, particles, n):
    rng = np.random.default_rng(seed)
    w = rng.random(particles) + 1e-3
    counts = np.bincount(systematic(rng, w, n), minlength=particles)
    share = n * w / w.sum()
    assert counts.sum() == n
    assert (counts >= np.floor(share - 1e-9)).all()
    assert (counts <= np.ceil(share + 1e-9)).all()


def test_systematic_never_draws_a_weightless_particle_and_refuses_no_weight():
    rng = np.random.default_rng(0)
    for _ in range(200):
        assert set(systematic(rng, np.array([0.0, 1.0, 0.0, 2.0, 0.0]), 7)) <= {1, 3}
    with pytest.raises(ValueError, match="cannot be resampled"):
        systematic(rng, np.zeros(3), 2)


def test_points_have_the_moments_they_were_drawn_from():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((5, 3, 3))
    m, P = rng.standard_normal((5, 3)), A @ np.swapaxes(A, 1, 2)
    x = spread(m, P, np.sqrt(3))
    w = np.full(6, 1 / 6)
    mean, cov, cross = weighted_moments(x, x, m, w, w, np.subtract)
    for a, b in ((mean, m), (cov, P), (cross, P)):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)


def test_a_periodic_image_averages_on_the_circle():
    circle = Space.of("azimuth_rad")
    z = np.array([[[np.pi - 0.1], [-np.pi + 0.3]]])
    mean, cov, _ = weighted_moments(np.zeros((1, 2, 1)), z, np.zeros((1, 1)), np.full(2, 0.5), np.full(2, 0.5), circle.residual)
    assert circle.residual(mean, np.array([[np.pi + 0.1]])) == pytest.approx(0, abs=1e-12)
    assert cov.item() == pytest.approx(0.04)


def test_balls_find_two_groups_and_ignore_scattered_weight():
    rng = np.random.default_rng(2)
    places = np.array([[1.0, 1], [4, 4], [4, 4]])
    x = np.concatenate([p + 0.05 * rng.standard_normal((300, 2)) for p in places] + [rng.uniform(0, 5, (300, 2))])
    w = np.concatenate([np.full(900, 1 / 300), np.full(300, 0.3 / 300)])
    found = balls(Cloud(np.log(w), x, np.zeros(1200, np.int64)), [0, 1], 0.4, 0.5, True)
    np.testing.assert_allclose(found.m, [[4, 4], [4, 4], [1, 1]], atol=0.03)
    assert len(balls(empty_cloud(2), [0, 1], 0.4, 0.5, True).w) == 0


def test_shared_reports_rows_above_the_threshold_heaviest_first():
    x = np.array([[0.0], [2.0], [10.0]])
    shares = np.array([[0.1, 0.5, 0.0], [0.1, 0.5, 0.0], [0.2, 0.0, 0.7]])
    found = shared(Cloud(np.zeros(3), x, np.zeros(3, np.int64)), shares, 0.5)
    np.testing.assert_allclose(found.m[:, 0], [1, 10])
    np.testing.assert_allclose(found.w, [1, 0.7])


def test_join_keeps_order():
    one = Cloud(np.zeros(2), np.ones((2, 3)), np.zeros(2, np.int64))
    assert len(join(empty_cloud(3), one, one).log_w) == 4


def test_kinematic_names_and_what_they_refuse():
    assert kinematic_space(3).names == ("x_m", "vx_m_s", "y_m", "vy_m_s", "z_m", "vz_m_s")
    assert position_columns(kinematic_space(3), "me") == [0, 2, 4]
    np.testing.assert_allclose(variances(kinematic_space(2), 2.0, 3.0, "me"), [4, 9, 4, 9])
    with pytest.raises(ValueError, match="dims is 4"):
        kinematic_space(4)
    with pytest.raises(SetupError, match=r"me places targets.*azimuth"):
        position_columns(Space.of("azimuth_rad"), "me")
    with pytest.raises(SetupError, match="me spreads positions"):
        variances(Space.of("x_m", "azimuth_rad"), 1, 1, "me")
