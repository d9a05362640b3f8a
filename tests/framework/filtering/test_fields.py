"""What a value on a curve says for a peak, and the probability that a target exists."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonobench.filtering.bernoulli import updated
from sonobench.filtering.fields import Peaks, calibrated, log_peak, log_shown, once


@pytest.mark.parametrize("scale", [3.0, 10.0])
@pytest.mark.parametrize("u", [-4.0, 0.0, 2.5, 12.0])
def test_the_odds_of_a_peak_are_the_integral_over_its_height(scale, u):
    a = np.linspace(0, 12 * scale, 400001)
    density = 2 / (scale * np.sqrt(2 * np.pi)) * np.exp(-0.5 * (a / scale) ** 2)
    assert log_peak(np.array(u), scale) == pytest.approx(np.log(np.trapezoid(density * np.exp(a * u - 0.5 * a * a), a)), abs=1e-5)


def test_noise_alone_is_on_average_as_likely_with_a_peak_as_without():
    u = np.linspace(-12, 12, 100001)
    noise = np.exp(-0.5 * u * u) / np.sqrt(2 * np.pi)
    peaks = Peaks(2.0, 5.0, 0.1)
    wide = np.linspace(-12, 80, 300001)
    assert np.trapezoid(noise * np.exp(log_peak(u, 5.0)), u) == pytest.approx(1.0, abs=0.05)  # the tail beyond 12 deviations
    density = np.exp(-0.5 * wide**2) / np.sqrt(2 * np.pi) * (0.9 + 0.1 * np.exp(np.minimum(log_peak(wide, 5.0), 700)))
    assert np.trapezoid(density * np.exp(log_shown(2.0 * wide, 0.4, peaks)), wide) == pytest.approx(1.0, abs=1e-3)


@given(st.floats(-10, 200), st.floats(0, 1), st.floats(1e-3, 0.5), st.floats(3, 50))
def test_no_value_counts_more_than_the_chance_that_it_is_anothers_peak_allows(u, p, share, scale):
    found = float(log_shown(np.array(u), p, Peaks(1.0, scale, share)))
    assert np.log1p(p * (1 / share - 1)) + 1e-9 >= found
    assert found >= (np.log1p(-p) if p < 1 else -np.inf) - 1e-9


def test_a_mode_that_cannot_show_says_nothing():
    assert log_shown(np.array([-1.0, 0.0, 9.0]), 0.0, Peaks(0.1, 5.0, 0.1)).tolist() == [0.0, 0.0, 0.0]


def test_calibration_finds_noise_height_and_share_of_a_made_up_curve():
    rng = np.random.default_rng(3)
    on = rng.random(20000) < 0.08
    u = rng.standard_normal(20000) + np.where(on, np.abs(8.0 * rng.standard_normal(20000)), 0.0)
    peaks = calibrated(0.03 * u)
    assert peaks.noise == pytest.approx(0.03, rel=0.15)
    assert peaks.scale == pytest.approx(8.0, rel=0.2)
    assert peaks.share == pytest.approx(0.08, abs=0.03)


def test_calibration_follows_the_curves_unit_and_refuses_a_curve_without_noise():
    curve = np.random.default_rng(0).standard_normal(500)
    a, b = calibrated(curve), calibrated(50 * curve)
    assert b.noise == pytest.approx(50 * a.noise)
    assert (a.scale, a.share) == pytest.approx((b.scale, b.share))
    assert calibrated(np.zeros(100)) is None
    assert calibrated(np.zeros(0)) is None


def test_places_that_coincide_count_once_and_places_apart_each():
    used = np.ones((2, 3), bool)
    weights = once(np.array([[1.0, 1.0, 5.0], [1.0, 2.5, 4.0]]), used, 1.0)
    np.testing.assert_allclose(weights, [[0.5, 0.5, 1.0], [1, 1, 1]])
    np.testing.assert_allclose(once(np.array([1.0, 1.0, 1.5]), np.array([True, False, True]), 1.0), [2 / 3, 0, 2 / 3])


@given(st.lists(st.floats(-3, 3), min_size=1, max_size=6))
def test_no_more_places_are_counted_than_there_are_and_never_less_than_one(places):
    weights = once(np.array(places), np.ones(len(places), bool), 0.5)
    assert 1 - 1e-9 <= weights.sum() <= len(places) + 1e-9


def test_existence_is_bayes_rule():
    w, g = np.array([0.1, 0.25, 0.05]), np.array([4.0, 0.5, 30.0])
    r, log_w = updated(0.6, np.log(w), np.log(g))
    total = 0.6 + w @ g
    assert r == pytest.approx(w @ g / total)
    np.testing.assert_allclose(np.exp(log_w), w * g / total)


def test_existence_survives_ratios_beyond_float64():
    r, log_w = updated(0.9, np.log([0.05, 0.05]), np.array([900.0, -900.0]))
    assert r == pytest.approx(1.0)
    np.testing.assert_allclose(np.exp(log_w), [1.0, 0.0])
    assert updated(0.9, np.log([0.1]), np.array([-900.0]))[0] == 0.0
    assert updated(1.0, np.zeros(0), np.zeros(0))[0] == 0.0
    with pytest.raises(ValueError, match="every weight is zero"):
        updated(0.0, np.zeros(1), np.array([-np.inf]))
