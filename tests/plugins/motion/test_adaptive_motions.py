"""Motions that adapt to what updates say: random walk, Langevin, constant velocity."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from sonobench.protocols import Motion
from sonobench.testing import check
from sonobench.types import Array
from sonobench_plugins.motion.adaptive_constant_velocity import AdaptiveConstantVelocity
from sonobench_plugins.motion.adaptive_langevin import AdaptiveLangevin
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.motion.random_walk import RandomWalk

DT_S = 0.032
MODE = np.zeros(1, np.int64)
MODELS = [RandomWalk(adaptive=True), AdaptiveLangevin(), AdaptiveConstantVelocity(), AdaptiveConstantVelocity(noise="printed")]


def read_only(*values: float) -> Array:
    a = np.array(values)
    a.flags.writeable = False
    return a


def settled(model: Any, prior: Array, posterior: Array) -> Any:
    """The memory after the same update many times."""
    memory = None
    for _ in range(1000):
        memory = model.adapt(memory, prior, posterior, DT_S)
    return memory


@pytest.mark.parametrize("model", MODELS, ids=str)
class TestEveryAdaptiveMotion:
    def test_fits_the_role(self, model: Any) -> None:
        assert isinstance(model, Motion)

    def test_draws_have_the_moments_that_the_memory_gives(self, model: Any) -> None:
        d, n = len(model.space), 20_000
        memory = settled(model, np.zeros(d), np.full(d, 0.03))
        x = np.tile(np.linspace(0.3, 0.6, d), (n, 1))
        drawn, _ = model.sample(np.random.default_rng(4), x, np.zeros(n, np.int64), DT_S, memory)
        m, Q = model.moments(x[:1], np.zeros((1, d, d)), MODE, DT_S, memory)
        scale = np.sqrt(np.diag(Q[0]))
        assert_allclose((drawn.mean(axis=0) - m[0]) / scale, 0, atol=5 / np.sqrt(n))
        assert_allclose(np.cov(drawn.T) / np.outer(scale, scale), Q[0] / np.outer(scale, scale), atol=0.05)
        assert np.isfinite(model.log_density(drawn, x, np.zeros(n, np.int64), DT_S, memory)).all()

    def test_large_and_small_corrections_end_at_the_limits(self, model: Any) -> None:
        d = len(model.space)
        low, high = model.limits_m if isinstance(model, RandomWalk) else model.limits_m_s
        power = 1 if isinstance(model, AdaptiveLangevin) else 2
        assert_allclose(settled(model, np.zeros(d), np.zeros(d)), low**power, rtol=1e-6)
        assert_allclose(settled(model, np.zeros(d), np.full(d, 1e3)), high**power, rtol=1e-6)


def test_constant_velocity_explains_the_velocity_gained_axis_by_axis() -> None:
    model = AdaptiveConstantVelocity(limits_m_s=(0.0, 10.0), memory_s=0.0, gain=2.0)
    q = model.adapt(None, read_only(0, 1, 0, 1), read_only(9, 1.1, 9, 0.95), DT_S)
    assert_allclose(q, [0.2**2 / DT_S, 0.1**2 / DT_S])
    assert_allclose(model.matrices(DT_S, q)[1][[1, 3], [1, 3]], [0.2**2, 0.1**2])


def test_constant_velocity_averages_over_its_memory() -> None:
    model = AdaptiveConstantVelocity(velocity_walk_m_s=1.0, limits_m_s=(0.0, 10.0), memory_s=0.25)
    q = model.adapt(None, read_only(0, 0, 0, 0), read_only(0, 0.4, 0, 0), DT_S)
    kept = np.exp(-DT_S / 0.25)
    assert_allclose(q, [kept + (1 - kept) * 0.4**2 / DT_S, kept])


def test_the_printed_noise_is_q_on_the_whole_diagonal_whatever_the_period() -> None:
    model = AdaptiveConstantVelocity(noise="printed", limits_m_s=(0.0, 10.0), memory_s=0.0, gain=0.5)
    q = model.adapt(None, read_only(0, 0, 0, 0), read_only(0, 0.1, 0, -0.2), DT_S)
    assert_allclose(q, [0.05 / DT_S, 0.1 / DT_S])
    for dt_s in (DT_S, 1.0):
        assert_allclose(model.matrices(dt_s, q)[1], np.diag([q[0], q[0], q[1], q[1]]))


def test_constant_velocity_that_learned_nothing_is_constant_velocity() -> None:
    for mine, plain in zip(AdaptiveConstantVelocity().matrices(0.3), ConstantVelocity(velocity_walk_m_s=1.0).matrices(0.3), strict=True):
        assert_allclose(mine, plain)


def test_langevin_takes_the_speed_of_the_estimate() -> None:
    model = AdaptiveLangevin(Langevin(v_rms_m_s=0.5))
    speed = settled(model, read_only(0, 0, 0, 0), read_only(0, 0.9, 0, 1.2))
    assert speed == pytest.approx(np.sqrt((0.81 + 1.44) / 2))
    x, P = np.array([[1.0, 0.5, 2.0, 0.1]]), np.zeros((1, 4, 4))
    for mine, plain in zip(model.moments(x, P, MODE, DT_S, speed), Langevin(v_rms_m_s=speed).moments(x, P, MODE, DT_S), strict=True):
        assert_array_equal(mine, plain)


def test_random_walk_takes_the_distance_that_updates_move() -> None:
    model = RandomWalk(adaptive=True, limits_m=(0.0, 10.0))
    variance = settled(model, read_only(1, 1), read_only(1.03, 0.96))
    assert variance == pytest.approx((0.03**2 + 0.04**2) / 2 / DT_S)
    assert_allclose(model.matrices(0.5, variance)[1], np.eye(2) * variance * 0.5)
    assert RandomWalk().adapt(None, read_only(0, 0), read_only(1, 1), DT_S) is None


def test_no_time_teaches_the_noise_nothing() -> None:
    assert AdaptiveConstantVelocity().adapt(None, read_only(0, 0, 0, 0), read_only(1, 1, 1, 1), 0.0) is None
    assert RandomWalk(adaptive=True).adapt(0.3, read_only(0, 0), read_only(1, 1), 0.0) == 0.3


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: RandomWalk(dims=1), "dims is 1"),
        (lambda: RandomWalk(limits_m=(2.0, 1.0)), "in order"),
        (lambda: AdaptiveLangevin(limits_m_s=(2.0, 1.0)), "in order"),
        (lambda: AdaptiveConstantVelocity(noise="full"), "'white' or 'printed'"),  # type: ignore[arg-type]
        (lambda: AdaptiveConstantVelocity(limits_m_s=(2.0, 1.0)), "limits in order"),
    ],
)
def test_bad_parameters_are_refused_with_what_was_needed(make: Callable[[], object], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make()


def test_a_walk_that_adapts_is_one_the_kit_accepts() -> None:
    assert [f for f in check(RandomWalk(adaptive=True), "motion") if not f.ok] == []
