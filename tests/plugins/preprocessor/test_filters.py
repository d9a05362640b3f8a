"""Pre-filter, pre-emphasis and normalisation against their definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from preprocessor_runs import RATE_HZ, response, run

from sonobench import SetupError
from sonobench_plugins.preprocessor.normalise import Normalise
from sonobench_plugins.preprocessor.pre_emphasis import PreEmphasis
from sonobench_plugins.preprocessor.pre_filter import PreFilter

ALL = [PreFilter(), PreFilter(200.0, 3000.0, order=2), PreEmphasis(), Normalise(memory_s=0.05), Normalise("peak")]


def _noise(n=4000, channels=3, seed=0):
    return np.random.default_rng(seed).standard_normal((n, channels)) * np.linspace(0.001, 0.3, n)[:, None]


@settings(max_examples=20, deadline=None)
@given(st.integers(0, len(ALL) - 1), st.lists(st.integers(0, 4000), max_size=12), st.integers(1, 9))
def test_how_the_samples_are_cut_changes_no_bit(which, cuts, channels):
    samples = _noise(channels=channels)
    np.testing.assert_array_equal(run(ALL[which], samples, cuts), run(ALL[which], samples))


def _decibels(component, *frequencies_hz):
    f, gain = response(component)
    return np.array([20 * np.log10(max(np.abs(np.interp(hz, f, np.abs(gain))), 1e-12)) for hz in frequencies_hz])


def test_a_high_pass_stops_a_constant_and_is_three_decibels_down_at_its_cut_off():
    low, cut, high = _decibels(PreFilter(500.0), 0.0, 500.0, RATE_HZ / 2)
    assert low < -150
    assert cut == pytest.approx(-3.01, abs=0.02)
    assert high == pytest.approx(0.0, abs=1e-6)


def test_a_low_pass_passes_a_constant_and_stops_half_the_rate():
    low, cut, high = _decibels(PreFilter(None, 1000.0), 0.0, 1000.0, RATE_HZ / 2)
    assert low == pytest.approx(0.0, abs=1e-6)
    assert cut == pytest.approx(-3.01, abs=0.02)
    assert high < -150


def test_a_band_pass_follows_the_butterworth_formula():
    """|H|² = 1 / (1 + ((w² − w0²) / (B w))^2n) of the frequencies that the bilinear transform warps."""
    low, high, order = 300.0, 2000.0, 3
    f, gain = response(PreFilter(low, high, order=order))
    warped = np.tan(np.pi * np.array([low, high]) / RATE_HZ)
    w = np.tan(np.pi * f[1:-1] / RATE_HZ)
    exact = 1 / (1 + ((w**2 - warped.prod()) / ((warped[1] - warped[0]) * w)) ** (2 * order))
    np.testing.assert_allclose(np.abs(gain[1:-1]) ** 2, exact, atol=1e-9)


def test_a_filter_keeps_the_delay_between_channels():
    noise = np.random.default_rng(1).standard_normal(8007)
    found = run(PreFilter(300.0, 3000.0), np.stack([noise[7:], noise[:-7]], axis=1))
    np.testing.assert_allclose(found[2007:, 1], found[2000:-7, 0], atol=1e-6)  # once the start is forgotten


def test_pre_emphasis_is_its_definition():
    samples, found = _noise(), run(PreEmphasis(0.9), _noise(), [1, 2, 777])
    np.testing.assert_array_equal(found[0], samples[0])
    np.testing.assert_array_equal(found[1:], samples[1:] - 0.9 * samples[:-1])
    assert _decibels(PreEmphasis(0.9), 0.0, RATE_HZ / 2) == pytest.approx(20 * np.log10([0.1, 1.9]), abs=1e-9)


def test_normalisation_by_rms_reaches_its_level_and_follows_a_step_with_its_time_constant():
    rng = np.random.default_rng(2)
    samples = np.concatenate([0.01 * rng.standard_normal((40000, 2)), 1.0 * rng.standard_normal((40000, 2))])
    found = run(Normalise(level=0.2, memory_s=0.25), samples)
    assert np.sqrt(np.mean(found[30000:40000] ** 2)) == pytest.approx(0.2, rel=0.05)
    assert np.sqrt(np.mean(found[70000:] ** 2)) == pytest.approx(0.2, rel=0.05)
    after = slice(40000 + 1900, 40000 + 2100)  # a time constant after the step: 1 − 1/e of the new power is in
    assert np.sqrt(np.mean(found[after] ** 2)) == pytest.approx(0.2 / np.sqrt(1 - np.exp(-1)), rel=0.15)


def test_normalisation_by_rms_is_the_recursion():
    samples, level = _noise(300), Normalise(level=0.3, memory_s=0.01, most=20.0)
    keep, power = np.exp(-1 / (RATE_HZ * 0.01)), 0.09
    for x, y in zip(samples, run(level, samples), strict=True):
        power = keep * power + (1 - keep) * np.mean(x**2)
        np.testing.assert_allclose(y, x * min(0.3 / np.sqrt(power), 20.0), rtol=1e-9)


def test_normalisation_by_peak_only_falls_and_never_exceeds_the_level():
    samples = _noise()
    gain = (run(Normalise("peak", level=0.5, most=100.0), samples) / samples)[:, 0]
    assert (np.diff(gain) <= 1e-9).all()
    assert gain[0] == pytest.approx(100.0)
    assert gain[-1] == pytest.approx(0.5 / np.abs(samples).max())


def test_a_cut_off_beyond_half_the_rate_is_refused_when_the_rate_is_known():
    with pytest.raises(SetupError, match="a cut-off below 4000 Hz is needed"):
        PreFilter(None, 4000.0).start(RATE_HZ, 2)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PreFilter(None, None), "cut-off"),
        (lambda: PreFilter(500.0, 400.0), "a lower and an upper"),
        (lambda: PreFilter(order=0), "order is 0"),
        (lambda: PreEmphasis(1.5), "0 to 1 is needed"),
        (lambda: Normalise("median"), "'rms' or 'peak'"),
        (lambda: Normalise(memory_s=0.0), "memory_s is 0.0"),
    ],
)
def test_impossible_parameters_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
