import math
from datetime import datetime, timedelta

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from sonobench.protocols import Motion
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.langevin import Langevin

MODELS = [Langevin(), Langevin(noise="diagonal"), Langevin(dims=3, rate_hz=2.0), ConstantVelocity(), ConstantVelocity(dims=3)]


def read_only(a):
    a = np.array(a, float)
    a.flags.writeable = False
    return a


@pytest.mark.parametrize("model", MODELS, ids=str)
class TestEveryMotion:
    def test_fits_the_role(self, model):
        assert isinstance(model, Motion)
        assert model.n_modes == 1

    def test_no_time_changes_nothing(self, model):
        rng = np.random.default_rng(0)
        x = read_only(rng.standard_normal((4, len(model.space))))
        P = read_only(np.stack([np.diag(rng.random(len(model.space)))] * 4))
        m, P1 = model.moments(x, P, np.zeros(4, np.int64), 0.0)
        drawn, _ = model.sample(rng, x, np.zeros(4, np.int64), 0.0)
        for a, b in ((m, x), (P1, P), (drawn, x)):
            np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(model.log_density(x, x, np.zeros(4, np.int64), 0.0), 0)
        np.testing.assert_array_equal(model.log_density(x + 1e-3, x, np.zeros(4, np.int64), 0.0), -np.inf)

    def test_draws_have_the_moments(self, model):
        rng = np.random.default_rng(1)
        d, n = len(model.space), 40_000
        x0 = read_only(rng.standard_normal((1, d)))
        x1, mode = model.sample(rng, np.repeat(x0, n, axis=0), np.zeros(n, np.int64), 0.2)
        m, Q = model.moments(x0, np.zeros((1, d, d)), np.zeros(1, np.int64), 0.2)
        scale = np.sqrt(np.diag(Q[0]))
        np.testing.assert_allclose((x1.mean(axis=0) - m[0]) / scale, 0, atol=5 / math.sqrt(n))
        np.testing.assert_allclose(np.cov(x1.T) / np.outer(scale, scale), Q[0] / np.outer(scale, scale), atol=0.04)
        assert mode.shape == (n,)

    def test_what_it_draws_it_gives_a_density(self, model):
        rng = np.random.default_rng(2)
        x0 = rng.standard_normal((200, len(model.space))) * 5
        mode = np.zeros(200, np.int64)
        for dt_s in (0.032, 0.5):
            x1, _ = model.sample(rng, x0, mode, dt_s)
            assert np.isfinite(model.log_density(x1, x0, mode, dt_s)).all()


def test_langevin_is_equation_36_simulated_literally():
    model, T, n = Langevin(rate_hz=10, v_rms_m_s=1.0), 0.032, 200_000
    rng = np.random.default_rng(3)
    a = math.exp(-10 * T)
    v = a * 0.5 + math.sqrt(1 - a * a) * rng.standard_normal(n)
    x = 1.0 + T * v
    m, P = model.moments(np.array([[1.0, 0.5, 0, 0]]), np.zeros((1, 4, 4)), np.zeros(1, np.int64), T)
    np.testing.assert_allclose([x.mean(), v.mean()], m[0, :2], atol=5 * math.sqrt((1 - a * a) / n))
    np.testing.assert_allclose(np.cov(x, v), P[0, :2, :2], rtol=0.02)


def test_langevin_keeps_its_steady_speed_and_the_printed_noise_is_its_diagonal():
    model = Langevin(v_rms_m_s=0.7)
    P = np.zeros((1, 4, 4))
    for _ in range(200):
        _, P = model.moments(np.zeros((1, 4)), P, np.zeros(1, np.int64), 0.1)
    assert P[0, 1, 1] == pytest.approx(0.49, rel=1e-12)
    Q, printed = Langevin().matrices(0.032)[1], Langevin(noise="diagonal").matrices(0.032)[1]
    b2 = 1 - math.exp(-0.64)
    np.testing.assert_allclose(np.diag(printed), [b2 * 0.032**2, b2] * 2, rtol=1e-14)
    np.testing.assert_array_equal(np.diag(Q), np.diag(printed))
    assert np.linalg.matrix_rank(Q[:2, :2], tol=1e-12) == 1
    assert (printed[~np.eye(4, dtype=bool)] == 0).all()


def test_langevin_support_is_position_plus_step_times_new_velocity():
    model, mode = Langevin(), np.zeros(2, np.int64)
    x0 = np.array([[0.0, 0, 0, 0]] * 2)
    x1 = np.array([[0.032, 1.0, 0.064, 2.0], [0.032 + 1e-6, 1.0, 0.064, 2.0]])
    log = model.log_density(x1, x0, mode, 0.032)
    b2 = 1 - math.exp(-0.64)
    along = math.sqrt(1 + 0.032**2)  # length along the support for each unit of velocity
    want = multivariate_normal(np.zeros(2), np.eye(2) * b2 * along**2).logpdf(np.array([1.0, 2.0]) * along)
    assert log[0] == pytest.approx(want, rel=1e-9)
    assert log[1] == -np.inf


def test_constant_velocity_is_stone_soups():
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel
    from stonesoup.models.transition.linear import ConstantVelocity as Theirs

    theirs = CombinedLinearGaussianTransitionModel([Theirs(0.09), Theirs(0.09)])
    F, Q = ConstantVelocity(velocity_walk_m_s=0.3).matrices(0.37)
    step = {"time_interval": timedelta(seconds=0.37), "timestamp": datetime(2026, 1, 1)}
    np.testing.assert_allclose(F, theirs.matrix(**step), rtol=1e-13)
    np.testing.assert_allclose(Q, theirs.covar(**step), rtol=1e-13)


def test_constant_velocity_over_two_steps_is_one_step_of_their_sum():
    model, mode = ConstantVelocity(), np.zeros(1, np.int64)
    x, P = np.array([[1.0, 2, 3, 4]]), np.eye(4)[None]
    once = model.moments(x, P, mode, 0.7)
    twice = model.moments(*model.moments(x, P, mode, 0.25), mode, 0.45)
    for a, b in zip(once, twice, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13)
    log = model.log_density(x + 0.1, x, mode, 0.7)
    m, Q = model.moments(x, np.zeros((1, 4, 4)), mode, 0.7)
    assert log[0] == pytest.approx(multivariate_normal(m[0], Q[0]).logpdf(x[0] + 0.1), rel=1e-9)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Langevin(dims=1), "dims is 1"),
        (lambda: Langevin(rate_hz=0), "rate_hz is 0"),
        (lambda: Langevin(noise="full"), "'exact' or 'diagonal'"),
        (lambda: ConstantVelocity(velocity_walk_m_s=-1), "at least 0"),
    ],
)
def test_bad_parameters_are_refused_with_what_was_needed(make, says):
    with pytest.raises(ValueError, match=says):
        make()
