import numpy as np
import pytest

from sonobench.errors import SetupError
from sonobench.filtering.bounds import posterior_covariances
from sonobench.geometry import unit_vector
from sonobench.types import Truth
from sonobench_plugins.metric.bearing_posterior_bound import BearingPosteriorBound
from sonobench_plugins.motion.bearing_turn import BearingTurn
from sonobench_plugins.motion.bearing_velocity import BearingVelocity
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.imm import Imm

POWERS = {"source_variance": 1.0, "pressure_noise_variance": 0.1, "velocity_noise_variance": 0.1, "snapshots": 1000.0}


def truth(k=20, rate=(0.02, -0.01), start=(0.3, 0.6)):
    time_s = np.arange(1.0, k + 1)
    z = np.array(start) + time_s[:, None] * np.array(rate)
    there = np.ones((k, 1), bool)
    return Truth(time_s, np.array([1]), 50 * unit_vector(z)[:, None], there, there, parameters=POWERS), z


def test_one_model_is_tichavskys_recursion():
    told, z = truth()
    bound = BearingPosteriorBound(motion=BearingVelocity(0.5))
    F, Q = bound.motion.matrices(1.0)
    H = np.zeros((20, 2, 4))
    H[:, 0, 0], H[:, 1, 2] = np.cos(z[:, 1]), 1.0
    P0 = np.diag(np.radians([30.0, 1.0, 30.0, 1.0]) ** 2)
    information = bound.frame.information(told)[:, 0]
    P = posterior_covariances(P0, np.tile(F, (20, 1, 1)), np.tile(Q, (20, 1, 1)), H, information)
    np.testing.assert_allclose(bound.least(told)[:, 0], H @ P @ np.swapaxes(H, 1, 2), rtol=1e-6, atol=1e-14)


def test_two_of_the_same_model_are_one_and_models_that_differ_cost():
    told, _ = truth(rate=(0.05, -0.03))
    one = BearingPosteriorBound(motion=BearingVelocity(0.1)).least(told)
    same = BearingPosteriorBound(motion=Imm((BearingVelocity(0.1), BearingVelocity(0.1)))).least(told)
    np.testing.assert_allclose(same, one, rtol=1e-9, atol=1e-14)
    apart = BearingPosteriorBound(motion=Imm((BearingVelocity(0.1), BearingTurn(20.0, 0.1), BearingTurn(-20.0, 0.1)))).least(told)
    trace = np.trace(apart - one, axis1=-2, axis2=-1)
    assert (trace[1:] > 0).all()


def test_a_motion_of_positions_is_refused_by_name():
    with pytest.raises(SetupError, match=r"follows angles.*x_m"):
        BearingPosteriorBound(motion=ConstantVelocity()).least(truth()[0])
