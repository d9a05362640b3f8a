import math

import numpy as np
import pytest

from sonobench.errors import SetupError
from sonobench.filtering.bearings import settled
from sonobench.filtering.mixture import any_mode, merge, predict
from sonobench.geometry import unit_vector
from sonobench.protocols import Mixture
from sonobench.testing import fixtures
from sonobench_plugins.motion.bearing_acceleration import BearingAcceleration
from sonobench_plugins.motion.bearing_turn import BearingTurn
from sonobench_plugins.motion.bearing_velocity import BearingVelocity
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.imm import Imm
from sonobench_plugins.motion.random_walk import RandomWalk
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.tracker.lmb import LabelledMultiBernoulli

ZERO = np.zeros(1, np.int64)


def test_over_the_pole_is_down_the_other_side():
    for elevation in (1.7, -1.7, 3.3, 6.0):
        x = np.array([0.3, 0.1, 0.01, elevation, 0.2, 0.03])
        there, sign = settled(x)
        np.testing.assert_allclose(unit_vector(there[[0, 3]]), unit_vector([0.3, elevation]), atol=1e-12)
        assert abs(there[3]) <= math.pi / 2
        assert -math.pi <= there[0] < math.pi
        np.testing.assert_allclose(there[4:], sign[4:] * x[4:])
        ahead = unit_vector([0.3 + 1e-6 * 0.1, elevation + 1e-6 * 0.2]) - unit_vector([0.3, elevation])
        after = unit_vector(there[[0, 3]] + 1e-6 * there[[1, 4]]) - unit_vector(there[[0, 3]])
        np.testing.assert_allclose(after, ahead, atol=1e-12)


@pytest.mark.parametrize("model", [BearingVelocity(), BearingTurn(30.0), BearingAcceleration(), BearingTurn(-2.0, accelerations=False)])
def test_two_half_steps_are_one(model):
    F, Q = model.matrices(1.4)
    f, q = model.matrices(0.7)
    np.testing.assert_allclose(f @ f, F, atol=1e-12)
    np.testing.assert_allclose(f @ q @ f.T + q, Q, rtol=1e-9, atol=2e-5 if isinstance(model, BearingTurn) else 0)


def test_a_turn_comes_round():
    model = BearingTurn(90.0, rate_walk_deg_s=0.0)
    x = np.array([[0.2, 0.05, -0.1, 0.02]])
    quarter, _ = model.moments(x, np.zeros((1, 4, 4)), ZERO, 1.0)
    np.testing.assert_allclose(quarter[0, [1, 3]], [-0.02, 0.05], atol=1e-12)
    np.testing.assert_allclose(model.moments(x, np.zeros((1, 4, 4)), ZERO, 4.0)[0], x, atol=1e-12)


def test_modes_are_a_markov_chain_for_any_time():
    equal = Imm((ConstantVelocity(), ConstantVelocity(), ConstantVelocity()), stay_s=4.0)
    rates = Imm(equal.models, rates_hz=((0.0, 0.125, 0.125), (0.125, 0.0, 0.125), (0.125, 0.125, 0.0)))
    np.testing.assert_allclose(equal.transition(0.7), rates.transition(0.7), atol=1e-12)
    np.testing.assert_allclose(equal.transition(0.3) @ equal.transition(0.4), equal.transition(0.7), atol=1e-12)
    mode = np.zeros(40_000, np.int64)
    _, after = equal.sample(np.random.default_rng(0), np.zeros((40_000, 4)), mode, 2.0)
    np.testing.assert_allclose(np.bincount(after) / 40_000, equal.transition(2.0)[0], atol=0.01)


def test_a_draw_moves_by_the_model_it_switched_to():
    calm, wild = ConstantVelocity(velocity_walk_m_s=0.0), ConstantVelocity(velocity_walk_m_s=5.0)
    x = np.tile([1.0, 0.5, 2.0, -0.5], (500, 1))
    moved, mode = Imm((calm, wild), stay_s=1.0).sample(np.random.default_rng(1), x, np.zeros(500, np.int64), 1.0)
    straight = np.isclose(moved, [1.5, 0.5, 1.5, -0.5]).all(axis=1)
    np.testing.assert_array_equal(straight, mode == 0)


def test_models_must_share_a_space_and_have_one_mode():
    with pytest.raises(ValueError, match="one state space"):
        Imm((BearingVelocity(), BearingAcceleration()))
    with pytest.raises(ValueError, match=r"one mode each; \['Imm'\]"):
        Imm((Imm(),))
    with pytest.raises(ValueError, match=r"never learn from updates, for which \['RandomWalk'\]"):
        Imm((RandomWalk(), RandomWalk(adaptive=True)))
    with pytest.raises(ValueError, match="2 rows of 2 rates"):
        Imm(rates_hz=((0.0, 1.0),))


def test_components_branch_and_merge_within_a_mode_as_the_imm_filter_mixes():
    motion = Imm(stay_s=2.0)
    m, P, _ = fixtures.gaussians(motion.space, 2)
    m[1] = m[0] + 1e-3
    start = Mixture(np.array([0.6, 0.4]), m, np.stack([P[0], P[0]]), np.array([0, 1]))
    moved = predict(start, motion, 0.9, 0.5)
    assert np.bincount(moved.mode).tolist() == [2, 2]
    p = motion.transition(0.5)
    np.testing.assert_allclose(np.bincount(moved.mode, moved.w), 0.9 * np.array([0.6, 0.4]) @ p)
    merged = merge(moved, 2.0, motion.space)
    assert sorted(merged.mode) == [0, 1]
    # the textbook order: mix the old modes first, then move each by its model; the same, since the models are linear
    for j, model in enumerate(motion.models):
        mu = start.w * p[:, j] / (start.w @ p[:, j])
        mean = mu @ m
        off = m - mean
        mixed = np.einsum("i,iab->ab", mu, start.P + off[:, :, None] * off[:, None, :])
        wanted = model.moments(mean[None], mixed[None], ZERO, 0.5)
        own = merged.mode == j
        np.testing.assert_allclose(merged.m[own], wanted[0], atol=1e-12)
        np.testing.assert_allclose(merged.P[own], wanted[1], atol=1e-12)
    assert len(merge(any_mode(merged), 2.0, motion.space).w) == 1


def test_gm_phd_reports_one_target_whatever_its_modes():
    setup = fixtures.setup("positions")
    scans = fixtures.scans(setup, fixtures.regular(12), clutter=0)
    from sonobench_plugins.birth.from_positions import FromPositions
    from sonobench_plugins.measurement.position import Position

    tracker = GaussianMixturePhd(motion=Imm(stay_s=0.5), measurement=Position(), birth=FromPositions())
    rng = np.random.default_rng(0)
    state = tracker.init(rng, setup)
    for scan in scans:
        state, estimate = tracker.step(rng, state, scan)
    assert len(estimate.states) == 2
    assert set(state.mixture.mode.tolist()) == {0, 1}


def test_lmb_refuses_several_modes_by_name():
    with pytest.raises(SetupError, match="lmb tracks one motion mode; motion Imm has 2"):
        LabelledMultiBernoulli(motion=Imm()).init(np.random.default_rng(0), fixtures.setup())
