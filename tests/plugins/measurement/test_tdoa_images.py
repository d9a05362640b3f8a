"""Echo delays against the image method's own arithmetic, their slopes, and what a set-up must have."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from sonobench.errors import SetupError
from sonobench.types import Sensor, Setup, Space
from sonobench_plugins.measurement.tdoa_images import TdoaImages

SPACE = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")
L0, C = 3.0, 344.0
M1, M2 = np.array([1.25, 0.01, 1.8]), np.array([1.75, 0.01, 1.8])


def setup(**more) -> Setup:
    pair = Sensor("pair-0", "a", "tdoa", np.stack([M1, M2]), Space.of("tau_s"), np.array([[0, 1]]))
    values = {
        "sensors": (pair,),
        "array_names": ("a",),
        "poses": np.eye(4)[None],
        "c_m_s": C,
        "box_m": np.array([[0.0, 0, 0], [L0, 3, 2.5]]),
        "nominal": {"p_d": 0.9, "clutter_per_scan": 2.0, "delay_std_s": 5e-5, "height_m": 1.8},
    }
    return Setup(**{**values, **more})


def states(n: int = 30) -> np.ndarray:
    return np.random.default_rng(0).uniform([0.2, -1, 0.2, -1], [2.8, 1, 2.8, 1], (n, 4))


def test_five_modes_are_the_thesis_equation_in_seconds_and_in_this_sign():
    x = states()
    px, py = x[:, 0], x[:, 2]

    def r(at_x, microphone):
        return np.hypot(at_x - microphone[0], py - microphone[1])

    metres = [
        r(px, M2) - r(px, M1),
        r(-px, M2) - r(px, M1),
        r(px, M2) - r(-px, M1),
        r(2 * L0 - px, M2) - r(px, M1),
        r(px, M2) - r(2 * L0 - px, M1),
    ]
    model = TdoaImages(reach_s=0.02).bind(SPACE, setup())
    assert model.n_modes == 5
    np.testing.assert_allclose(model.h(x, 0)[..., 0], -np.stack(metres, axis=-1) / C, rtol=1e-12)


def test_both_adds_the_delay_between_images_of_one_wall():
    model = TdoaImages(reach_s=0.02, walls=("x0", "y1"), both=True).bind(SPACE, setup())
    x = states()
    assert model.n_modes == 7
    mirrored = x.copy()
    mirrored[:, 0] *= -1
    np.testing.assert_allclose(model.h(x, 0)[:, 3], model.h(mirrored, 0)[:, 0], rtol=1e-12)
    mirrored = x.copy()
    mirrored[:, 2] = 6 - mirrored[:, 2]
    np.testing.assert_allclose(model.h(x, 0)[:, 6], model.h(mirrored, 0)[:, 0], rtol=1e-12)


@pytest.mark.parametrize("walls", [(), ("x0",), ("x0", "x1", "y1", "z0")])
def test_slopes_are_central_differences(walls):
    model = TdoaImages(reach_s=0.02, walls=walls, both=True).bind(SPACE, setup())
    x, step = states(), 1e-6
    found = model.jacobian(x, 0)
    assert found.shape == (30, 1 + 3 * len(walls), 1, 4)
    for k in range(4):
        ahead = step * np.eye(4)[k]
        numeric = (model.h(x + ahead, 0) - model.h(x - ahead, 0)) / (2 * step)
        np.testing.assert_allclose(found[..., k], numeric, atol=1e-9)


def test_a_mode_beyond_the_front_ends_reach_is_never_detected():
    model = TdoaImages(reach_s=0.003).bind(SPACE, setup())
    x = states()
    p = model.p_d(x, 0)
    far = np.abs(model.h(x, 0)[..., 0]) > 0.003
    assert far.any()
    assert (p[far] == 0).all()
    assert set(np.unique(p[~far])) == {0.4, 0.9}


def test_clutter_is_a_density_over_the_reach():
    model = TdoaImages(reach_s=0.003).bind(SPACE, setup())
    z = np.linspace(-0.0029, 0.0029, 5)[:, None]
    np.testing.assert_allclose(np.exp(model.log_clutter(z, 0)), 2.0 / 0.006)
    assert np.isneginf(model.log_clutter(np.array([[0.0034]]), 0)).all()
    assert np.isneginf(TdoaImages(reach_s=0.003, clutter_per_scan=0.0).bind(SPACE, setup()).log_clutter(z, 0)).all()


def test_what_the_setup_lacks_and_impossible_parameters_are_named():
    with pytest.raises(SetupError, match="free field"):
        TdoaImages(reach_s=0.01).bind(SPACE, setup(box_m=None))
    stack = Sensor("stack", "a", "tdoa", np.stack([M1, M2, M1]), Space.of("tau0_s", "tau1_s"), np.array([[0, 1], [1, 2]]))
    with pytest.raises(SetupError, match=r"'stack'.*several"):
        TdoaImages(reach_s=0.01).bind(SPACE, setup(sensors=(stack,)))
    for values in ({"reach_s": 0.0}, {"walls": ("x0", "x0")}, {"walls": ("w1",)}, {"p_d_echo": 1.2}, {"clutter_per_scan": -1.0}):
        with pytest.raises(ValueError, match="needed"):
            TdoaImages(**{"reach_s": 0.01, **values})


def test_a_bound_model_pickles():
    model = TdoaImages(reach_s=0.01).bind(SPACE, setup())
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).h(states(), 0), model.h(states(), 0))
