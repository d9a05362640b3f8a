"""Tones, harmonics and speech-shaped noise: spectra by Welch's method, levels, bands, seeds."""

import numpy as np
import pytest
from scipy.signal import welch

from sonobench_plugins.sound.speech_noise import SpeechNoise, speech_level_db
from sonobench_plugins.sound.tones import Harmonic, Multitone

RATE_HZ = 16000.0
ALL = [Multitone(), Multitone([440.0]), Harmonic(), Harmonic(f0_hz=220.0, vibrato_cents=60.0), SpeechNoise()]


def _made(sound, seconds=4.0, seed=1, rate_hz=RATE_HZ):
    return sound.render(np.random.default_rng(seed), seconds, rate_hz)


def _density(samples, length=8000):
    return welch(samples, RATE_HZ, "hann", length)


@pytest.mark.parametrize("sound", ALL, ids=repr)
def test_a_sound_has_its_level_and_all_its_energy_within_its_band(sound):
    made = _made(sound)
    assert np.sqrt(np.mean(made.samples**2)) == pytest.approx(0.1, rel=0.03)
    f, power = np.fft.rfftfreq(64000, 1 / RATE_HZ), np.abs(np.fft.rfft(made.samples * np.hanning(64000))) ** 2
    inside = (f >= made.band_hz[0]) & (f <= made.band_hz[1])
    assert power[~inside].sum() < 1e-5 * power.sum()
    assert 0 <= made.band_hz[0] < made.band_hz[1] <= RATE_HZ / 2


@pytest.mark.parametrize("sound", ALL, ids=repr)
def test_the_seed_alone_decides(sound):
    np.testing.assert_array_equal(_made(sound, 0.3).samples, _made(sound, 0.3).samples)
    assert np.any(_made(sound, 0.3).samples != _made(sound, 0.3, seed=2).samples)


def test_multitone_is_equally_strong_lines_and_nothing_between():
    f, power = _density(_made(Multitone([500.0, 1000.0, 3000.0])).samples)
    lines = [power[np.abs(f - hz) <= 6].sum() for hz in (500, 1000, 3000)]
    np.testing.assert_allclose(lines, lines[0], rtol=1e-3)
    assert sum(lines) > 0.9999 * power.sum()


def test_harmonics_fall_by_six_decibels_an_octave_up_to_the_highest():
    f, power = _density(_made(Harmonic(f0_hz=200.0, high_hz=3500.0)).samples)
    lines = np.array([power[np.abs(f - 200 * k) <= 6].sum() for k in range(1, 40)])
    np.testing.assert_allclose(10 * np.log10(lines[[1, 3, 7]] / lines[[0, 1, 3]]), -6.0, atol=0.05)
    assert (lines[:17] > 1e-3 * lines[0]).all()  # 17 · 200 = 3400
    assert (lines[17:] < 1e-9 * lines[0]).all()


def test_vibrato_bends_the_pitch_by_its_depth_at_its_rate():
    from scipy.signal import hilbert

    made = _made(Harmonic(f0_hz=400.0, high_hz=500.0, vibrato_hz=5.0, vibrato_cents=100.0))
    pitch = np.diff(np.unwrap(np.angle(hilbert(made.samples))))[4000:-4000] * RATE_HZ / (2 * np.pi)
    assert 1200 * np.log2(np.array([pitch.min(), pitch.max()]) / 400) == pytest.approx(
        [-100, 100], abs=2.5
    )  # of the Hilbert transform of a cut piece
    wave = np.log2(pitch[::4] / 400)
    f = np.fft.rfftfreq(len(wave), 4 / RATE_HZ)
    assert f[1 + np.argmax(np.abs(np.fft.rfft(wave))[1:])] == pytest.approx(5.0, abs=0.3)


def test_speech_noise_has_the_tables_spectrum():
    f, power = _density(_made(SpeechNoise(), 60.0).samples, 4000)
    centres = 1000 * 2.0 ** (np.arange(-7, 9) / 3)
    bands = [power[(f >= c * 2 ** (-1 / 6)) & (f < c * 2 ** (1 / 6))].mean() for c in centres]
    found = 10 * np.log10(np.array(bands) / bands[7])
    printed = [34.48, 34.75, 33.98, 34.59, 34.27, 32.06, 28.30, 25.01, 23.00, 20.15, 17.32, 13.18, 11.55, 9.33, 5.31, 2.59]
    np.testing.assert_allclose(found, np.array(printed) - 25.01, atol=0.7)  # means over bands of a slope, and sixty seconds


def test_the_tables_level_adds_up_to_the_standards_overall_level():
    """ANSI S3.5-1997 gives normal speech 62.35 dB in all."""
    f = np.arange(100.0, 9100.0)
    assert 10 * np.log10(np.sum(10 ** (speech_level_db(f) / 10))) == pytest.approx(62.35, abs=0.3)


def test_the_expected_level_of_speech_noise_is_exact_for_any_length():
    for n in (49, 50):
        levels = [np.mean(SpeechNoise(1.0).render(np.random.default_rng(s), n / 4000, 4000.0).samples ** 2) for s in range(3000)]
        assert np.mean(levels) == pytest.approx(1.0, abs=4 * np.std(levels) / np.sqrt(3000))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Multitone([]), "one or more"),
        (lambda: Multitone([100.0, 100.0]), "different"),
        (lambda: Harmonic(f0_hz=0.0), "f0_hz is 0.0"),
        (lambda: Harmonic(vibrato_cents=-1.0), "0 to 1200"),
        (lambda: SpeechNoise(0.0), "a positive"),
        (lambda: _made(Multitone([9000.0])), "below 8000 Hz are needed"),
        (lambda: _made(Harmonic(f0_hz=300.0, high_hz=250.0)), "lower f0_hz"),
        (lambda: _made(SpeechNoise(), rate_hz=200.0), "hold no frequency"),
    ],
)
def test_impossible_parameters_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()
