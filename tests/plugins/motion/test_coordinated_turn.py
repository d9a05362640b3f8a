"""The coordinated turn: its flow, its limits, its noise."""

import math

import numpy as np
import pytest

from sonobench.protocols import Motion
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.coordinated_turn import CoordinatedTurn

STILL = CoordinatedTurn(turn_std_rad_s=0.0, turn_time_s=math.inf, along_walk_m_s=0.0, across_walk_m_s=0.0)
ZERO = np.zeros(1, np.int64)


def read_only(a):
    a = np.array(a, float)
    a.flags.writeable = False
    return a


def test_fits_the_role():
    assert isinstance(CoordinatedTurn(), Motion)
    assert CoordinatedTurn().space.names == ("x_m", "vx_m_s", "y_m", "vy_m_s", "turn_rad_s")


def test_without_noise_it_walks_a_circle():
    x = read_only([[1.0, 0.0, 0.0, 0.5, 0.5]])  # on the unit circle, counter-clockwise
    for t in (0.01, 1.0, 3.0):
        moved, _ = STILL.sample(np.random.default_rng(0), x, ZERO, t)
        c, s = math.cos(t / 2), math.sin(t / 2)
        np.testing.assert_allclose(moved, [[c, -s / 2, s, c / 2, 0.5]], atol=1e-12)


def test_two_half_steps_are_a_whole_one_without_noise():
    x = read_only(np.random.default_rng(1).standard_normal((6, 5)))
    mode = np.zeros(6, np.int64)
    half, _ = STILL.sample(np.random.default_rng(0), x, mode, 0.15)
    np.testing.assert_allclose(
        STILL.sample(np.random.default_rng(0), half, mode, 0.15)[0], STILL.sample(np.random.default_rng(0), x, mode, 0.3)[0], atol=1e-12
    )


def test_without_turning_it_is_constant_velocity():
    rng = np.random.default_rng(2)
    x, A = rng.standard_normal((3, 4)), rng.standard_normal((3, 4, 4))
    P = A @ np.swapaxes(A, 1, 2)
    full = np.zeros((3, 5, 5))
    full[:, :4, :4] = P
    model = CoordinatedTurn(turn_std_rad_s=0.0, along_walk_m_s=0.4, across_walk_m_s=0.4)
    m1, P1 = model.moments(np.column_stack([x, np.zeros(3)]), full, np.zeros(3, np.int64), 0.1)
    m2, P2 = ConstantVelocity(velocity_walk_m_s=0.4).moments(x, P, np.zeros(3, np.int64), 0.1)
    np.testing.assert_allclose(m1[:, :4], m2, atol=1e-12)
    np.testing.assert_allclose(P1[:, :4, :4], P2, atol=1e-6)  # a root of a singular P leaves its space by the root of a rounding


def test_moments_are_those_of_many_draws():
    rng, n = np.random.default_rng(3), 200_000
    model = CoordinatedTurn(turn_std_rad_s=0.7, turn_time_s=0.8, along_walk_m_s=0.2, across_walk_m_s=0.5)
    m = np.array([1.0, 0.6, 2.0, -0.8, 0.5])
    P = np.diag([0.01, 0.02, 0.03, 0.02, 0.2])
    start = rng.multivariate_normal(m, P, n)
    drawn, mode = model.sample(rng, read_only(start), np.zeros(n, np.int64), 0.2)
    mean, cov = (a[0] for a in model.moments(read_only(m[None]), read_only(P[None]), ZERO, 0.2))
    scale = np.sqrt(np.diag(cov))
    np.testing.assert_allclose((drawn.mean(axis=0) - mean) / scale, 0, atol=0.02)
    np.testing.assert_allclose(np.cov(drawn.T) / np.outer(scale, scale), cov / np.outer(scale, scale), atol=0.03)
    assert mode.shape == (n,)


def test_noise_along_the_way_changes_the_speed_alone():
    model = CoordinatedTurn(turn_std_rad_s=0.0, turn_time_s=math.inf, along_walk_m_s=0.5, across_walk_m_s=0.0)
    x = read_only(np.tile([0.0, 0.6, 0.0, 0.8, 0.0], (50, 1)))
    drawn, _ = model.sample(np.random.default_rng(4), x, np.zeros(50, np.int64), 0.1)
    np.testing.assert_allclose(drawn[:, 1] * 0.8, drawn[:, 3] * 0.6, atol=1e-7)
    assert np.hypot(drawn[:, 1], drawn[:, 3]).std() > 0.1


def test_the_density_is_that_of_its_noise_and_no_time_is_a_point():
    model, x = CoordinatedTurn(turn_std_rad_s=0.8), read_only([[0.0, 1.0, 0.0, 0.0, 0.3]])
    moved, _ = STILL.sample(np.random.default_rng(0), x, ZERO, 0.1)
    away = moved.copy()
    away[0, 4] = 0.3 * math.exp(-0.1) + 0.8 * math.sqrt(-math.expm1(-0.2))  # one deviation of the turn's kick
    moved[0, 4] = 0.3 * math.exp(-0.1)
    assert model.log_density(moved, x, ZERO, 0.1) - model.log_density(away, x, ZERO, 0.1) == pytest.approx(0.5)
    np.testing.assert_array_equal(model.log_density(x, x, ZERO, 0.0), 0)
    np.testing.assert_array_equal(model.log_density(x + 1e-3, x, ZERO, 0.0), -np.inf)


@pytest.mark.parametrize("wrong", [{"turn_std_rad_s": -1.0}, {"turn_time_s": 0.0}, {"along_walk_m_s": math.inf}])
def test_impossible_parameters_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        CoordinatedTurn(**wrong)
