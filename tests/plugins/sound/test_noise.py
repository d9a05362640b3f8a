"""White and pink noise: level, spectrum, seed."""

import numpy as np
import pytest

from sonobench_plugins.sound.noise import Pink, White


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
