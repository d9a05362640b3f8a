import numpy as np
import phd_scenes as scenes
import pytest
from phd_linear import Position, mixture, setup

from sonobench.protocols import Mixture, Transform
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.transform.cubature import Cubature
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

SPACE = Langevin().space
ALL = [Linearised(), Unscented(), Unscented(alpha=0.5, beta=0.0, kappa=-1.0), Cubature()]


def components(n=12, spread=0.1, seed=0):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, 4, 4)) * spread
    mix = Mixture(np.ones(n), rng.uniform(0.3, 2.7, (n, 4)), A @ np.swapaxes(A, 1, 2) + 1e-4 * np.eye(4), np.zeros(n, np.int64))
    for a in mix:
        a.flags.writeable = False
    return mix


@pytest.mark.parametrize("transform", ALL, ids=str)
def test_every_transform_is_exact_for_a_linear_function(transform):
    assert isinstance(transform, Transform)
    mix, model = mixture(np.random.default_rng(0), 6), Position().bind(SPACE, setup())
    z_hat, S, cross = transform.measure(mix.m, mix.P, model, 0)
    H = model.H()
    np.testing.assert_allclose(z_hat, mix.m @ H.T, rtol=0, atol=1e-13)
    np.testing.assert_allclose(S, H @ mix.P @ H.T, rtol=0, atol=1e-12)
    np.testing.assert_allclose(cross, mix.P @ H.T, rtol=0, atol=1e-12)


def test_unscented_without_central_weight_is_cubature():
    mix, model = components(), Tdoa().bind(SPACE, scenes.setup())
    ours = Unscented(alpha=1.0, beta=0.0, kappa=0.0).measure(mix.m, mix.P, model, 0)
    for a, b in zip(ours, Cubature().measure(mix.m, mix.P, model, 0), strict=True):
        assert np.abs(a - b).max() <= 1e-13 * np.abs(b).max()


@pytest.mark.parametrize("transform", ALL, ids=str)
def test_a_batch_is_its_members(transform):
    mix, model = components(), Tdoa().bind(SPACE, scenes.setup())
    together = transform.measure(mix.m, mix.P, model, 0)
    for i in range(len(mix.w)):
        for a, b in zip(together, transform.measure(mix.m[i], mix.P[i], model, 0), strict=True):
            np.testing.assert_allclose(a[i], b, rtol=1e-12, atol=1e-22)


@pytest.mark.parametrize("transform", [Unscented(), Unscented(alpha=0.7, kappa=1.0), Cubature()], ids=str)
def test_points_have_the_moments_of_the_gaussian(transform):
    mix = components()
    x, w = transform.points(mix.m, mix.P)
    assert w.sum() == pytest.approx(1)
    np.testing.assert_allclose(np.einsum("p,jpd->jd", w, x), mix.m, rtol=1e-12)
    off = x - mix.m[:, None]
    np.testing.assert_allclose(np.einsum("p,jpa,jpb->jab", w, off, off), mix.P, rtol=0, atol=1e-13)


def test_cubature_covariances_are_equations_9_to_11_as_printed():
    mix, model = components(), Tdoa().bind(SPACE, scenes.setup())
    x, _ = Cubature().points(mix.m, mix.P)
    z = model.h(x, 0)[..., 0, :]
    z_hat = z.mean(axis=1)
    S = np.einsum("jpa,jpb->jab", z, z) / 8 - z_hat[:, :, None] * z_hat[:, None, :]
    cross = np.einsum("jpa,jpb->jab", x, z) / 8 - mix.m[:, :, None] * z_hat[:, None, :]
    for a, b in zip(Cubature().measure(mix.m, mix.P, model, 0), (z_hat, S, cross), strict=True):
        np.testing.assert_allclose(a, b, rtol=0, atol=1e-12 * np.abs(b).max() + 1e-18)


def test_cubature_beats_linearisation_where_the_delay_bends():
    mix, model = components(spread=0.4), Tdoa().bind(SPACE, scenes.setup())
    rng = np.random.default_rng(1)
    draws = mix.m + np.einsum("jab,njb->nja", np.linalg.cholesky(mix.P), rng.standard_normal((20_000, len(mix.w), 4)))
    truth = model.h(draws, 0)[:, :, 0].mean(axis=0)
    errors = [np.abs(t.measure(mix.m, mix.P, model, 0)[0] - truth).mean() for t in (Linearised(), Cubature())]
    assert errors[1] < 0.5 * errors[0]


def test_components_without_spread_pass_through_h():
    mix, model = components(), Tdoa().bind(SPACE, scenes.setup())
    for transform in ALL:
        z_hat, S, cross = transform.measure(mix.m, np.zeros_like(mix.P), model, 0)
        np.testing.assert_allclose(z_hat, model.h(mix.m, 0)[:, 0], rtol=0, atol=1e-17)
        assert np.abs(S).max() < 1e-30
        assert (cross == 0).all()


def test_a_scale_that_leaves_no_spread_is_refused():
    with pytest.raises(ValueError, match="kappa is -4"):
        Unscented(kappa=-4.0).points(np.zeros(4), np.eye(4))
    with pytest.raises(ValueError, match="alpha is 0"):
        Unscented(alpha=0.0)
