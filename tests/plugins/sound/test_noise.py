"""White and pink noise: level, spectrum, seed."""

import numpy as np
import pytest

from sonobench_plugins.sound.noise import NarrowBand, Pink, White


def power(sound, seconds=60.0, rate=8000.0):
    samples = sound.render(np.random.default_rng(1), seconds, rate).samples
    pieces = samples.reshape(-1, 8000)
    return np.abs(np.fft.rfft(pieces * np.hanning(8000), axis=1)).__pow__(2).mean(axis=0)


@pytest.mark.parametrize("sound", [White(0.2), Pink(0.2)])
def test_noise_has_its_level_length_and_seed(sound):
    made = sound.render(np.random.default_rng(3), 20.0, 8000.0)
    assert made.samples.shape == (160000,)
    assert np.sqrt(np.mean(made.samples**2)) == pytest.approx(0.2, rel=0.03)
    np.testing.assert_array_equal(made.samples, sound.render(np.random.default_rng(3), 20.0, 8000.0).samples)
    assert np.any(made.samples != sound.render(np.random.default_rng(4), 20.0, 8000.0).samples)


def test_white_is_flat_and_pink_falls_by_three_decibels_an_octave():
    octaves = [(125 * 2**i, 250 * 2**i) for i in range(4)]
    for sound, slope in ((White(), 0.0), (Pink(), -1.0)):
        levels = [power(sound)[a:b].mean() for a, b in octaves]
        np.testing.assert_allclose(np.diff(np.log2(levels)), slope, atol=0.08)


def test_the_expected_level_of_pink_noise_is_exact_for_any_length():
    for n in (9, 10):  # so few bins that the one at half the rate counts
        sound = Pink(1.0, low_hz=1.0)
        levels = [np.mean(sound.render(np.random.default_rng(s), n / 8000, 8000.0).samples ** 2) for s in range(4000)]
        assert np.mean(levels) == pytest.approx(1.0, abs=4 * np.std(levels) / np.sqrt(4000))


def test_pink_noise_has_nothing_below_its_lowest_frequency():
    spectrum = np.abs(np.fft.rfft(Pink(low_hz=100.0).render(np.random.default_rng(0), 1.0, 8000.0).samples))
    assert spectrum[:100].max() < 1e-9 < spectrum[100:110].min()


@pytest.mark.parametrize("make", [lambda: White(0.0), lambda: Pink(-1.0), lambda: Pink(low_hz=0.0)])
def test_impossible_parameters_are_refused(make):
    with pytest.raises(ValueError, match="a positive"):
        make()


@pytest.mark.parametrize(("distribution", "kurtosis"), [("gaussian", 0.0), ("uniform", -1.2), ("laplace", 3.0)])
def test_white_samples_have_the_stated_variance_and_distribution(distribution, kurtosis):
    x = White(0.5, distribution).render(np.random.default_rng(2), 50.0, 8000.0).samples / 0.5
    assert np.mean(x**2) == pytest.approx(1.0, abs=4 * np.std(x**2) / np.sqrt(len(x)))
    assert np.mean(x**4) - 3 == pytest.approx(kurtosis, abs=4 * np.std(x**4) / np.sqrt(len(x)))
    assert abs(np.mean(x[1:] * x[:-1])) < 4 / np.sqrt(len(x))


def test_narrow_band_noise_has_its_level_within_its_band_and_nothing_outside():
    sound = NarrowBand(centre_hz=600.0, bandwidth_hz=80.0, rms=0.3)
    made = sound.render(np.random.default_rng(1), 20.0, 8000.0)
    spectrum = np.abs(np.fft.rfft(made.samples))
    frequency = np.fft.rfftfreq(160000, 1 / 8000)
    assert made.band_hz == (560.0, 640.0)
    assert spectrum[(frequency < 559.99) | (frequency > 640.01)].max() < 1e-8
    halves = [np.mean(spectrum[(frequency >= low) & (frequency < low + 40)] ** 2) for low in (560, 600)]
    assert halves[0] == pytest.approx(halves[1], rel=0.2)
    levels = [np.mean(sound.render(np.random.default_rng(s), 0.5, 8000.0).samples ** 2) for s in range(400)]
    assert np.mean(levels) == pytest.approx(0.09, abs=4 * np.std(levels) / 20)


def test_a_narrow_band_must_fit_below_half_the_rate_and_hold_a_frequency():
    with pytest.raises(ValueError, match="begins at 0 Hz or above"):
        NarrowBand(centre_hz=100.0, bandwidth_hz=300.0)
    with pytest.raises(ValueError, match="ends at 1050 Hz; at 2000 Hz"):
        NarrowBand().render(np.random.default_rng(0), 1.0, 2000.0)
    with pytest.raises(ValueError, match="widen the band"):
        NarrowBand(centre_hz=1000.5, bandwidth_hz=0.2).render(np.random.default_rng(0), 1.0, 8000.0)
