"""Noise reduction: reconstruction, the gain in signal-to-noise ratio, phases between channels, and the noise that it learns."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from preprocessor_runs import RATE_HZ, run

from sonobench import SetupError
from sonobench_plugins.preprocessor.noise_reduction import NoiseReduction

RULES = ["wiener", "subtraction"]
LAG = 3


def _tone_in_noise(seconds=4.0, channels=2, seed=0):
    """(n, c) noise with 600 ms of a tone a second, LAG samples later on the second channel, and the tone alone."""
    n = round(seconds * RATE_HZ)
    time_s = (np.arange(n)[:, None] - LAG * np.arange(channels)) / RATE_HZ
    tone = 0.02 * np.sin(2 * np.pi * 440 * time_s) * (np.mod(time_s, 1.0) > 0.4)
    return tone + 0.01 * np.random.default_rng(seed).standard_normal((n, channels)), tone


def _ratio_db(found, tone):
    """Power along the tone over the power beside it, where the tone sounds, after two seconds to learn."""
    on = (np.abs(tone[:, 0]) > 0) & (np.arange(len(tone)) > 2 * RATE_HZ)
    y, s = found[on], tone[on]
    share = np.sum(y * s) / np.sum(s * s)
    return 10 * np.log10(np.sum((share * s) ** 2) / np.sum((y - share * s) ** 2)), share


@pytest.mark.parametrize("rule", RULES)
@settings(max_examples=12, deadline=None)
@given(st.integers(1, 5), st.integers(1, 3000), st.lists(st.integers(0, 3000), max_size=8))
def test_how_the_samples_are_cut_changes_no_bit(rule, channels, n, cuts):
    samples = _tone_in_noise(3000 / RATE_HZ, channels)[0][:n]
    whole = run(NoiseReduction(rule), samples)
    assert whole.shape == samples.shape
    np.testing.assert_array_equal(run(NoiseReduction(rule), samples, [c for c in cuts if c < n]), whole)


@pytest.mark.parametrize("rule", RULES)
@pytest.mark.parametrize("n", [1, 50, 128, 129, 256, 3001])
def test_with_a_floor_of_one_every_sample_comes_back_in_its_place(rule, n):
    samples = _tone_in_noise()[0][:n]
    np.testing.assert_allclose(run(NoiseReduction(rule, floor=1.0), samples), samples, atol=1e-15)


@pytest.mark.parametrize(("rule", "gain_db"), [("wiener", 12.0), ("subtraction", 5.0)])
def test_the_tone_stands_further_above_the_noise_and_keeps_its_level(rule, gain_db):
    samples, tone = _tone_in_noise()
    before, _ = _ratio_db(samples, tone)
    after, share = _ratio_db(run(NoiseReduction(rule), samples), tone)
    assert after - before > gain_db
    assert share == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("rule", RULES)
def test_pauses_fall_by_the_floor(rule):
    samples, tone = _tone_in_noise()
    quiet = (np.abs(tone).max(axis=1) == 0) & (np.arange(len(tone)) > 2 * RATE_HZ) & (np.mod(np.arange(len(tone)) / RATE_HZ, 1) > 0.1)
    quiet &= np.mod(np.arange(len(tone)) / RATE_HZ, 1) < 0.35
    fall_db = 10 * np.log10(np.mean(run(NoiseReduction(rule), samples)[quiet] ** 2) / np.mean(samples[quiet] ** 2))
    assert -20.5 < fall_db < (-18 if rule == "wiener" else -6)


@pytest.mark.parametrize("rule", RULES)
def test_channels_that_differ_by_a_factor_still_do_and_their_phases_are_the_same(rule):
    one = _tone_in_noise(channels=1)[0]
    found = run(NoiseReduction(rule), one * np.array([1.0, -2.5]))
    np.testing.assert_allclose(found[:, 1], -2.5 * found[:, 0], atol=1e-12)


@pytest.mark.parametrize("rule", RULES)
def test_the_phase_between_channels_at_the_tone_is_the_delay(rule):
    samples, tone = _tone_in_noise()
    found = run(NoiseReduction(rule), samples)
    turn = np.exp(-2j * np.pi * 440 * np.arange(len(found)) / RATE_HZ)
    on = (np.abs(tone).max(axis=1) > 0) & (np.arange(len(tone)) > 2 * RATE_HZ)
    phase = [np.angle(np.sum(x[on, 1] * turn[on]) / np.sum(x[on, 0] * turn[on])) for x in (samples, found)]
    expected = -2 * np.pi * 440 * LAG / RATE_HZ
    assert phase[1] == pytest.approx(expected, abs=0.02)  # a twentieth of a sample, at 6 dB
    assert phase[1] == pytest.approx(phase[0], abs=0.005)


def test_a_sound_at_the_start_is_not_kept_for_noise_once_a_pause_has_come():
    n = round(3 * RATE_HZ)
    time_s = np.arange(n) / RATE_HZ
    sounding = (time_s < 0.8) | (time_s > 2.0)
    tone = (0.1 * np.sin(2 * np.pi * 440 * time_s) * sounding)[:, None]
    found = run(NoiseReduction(), tone + 0.001 * np.random.default_rng(3).standard_normal((n, 1)))
    late = time_s > 2.2
    assert np.sum(found[late] * tone[late]) / np.sum(tone[late] ** 2) == pytest.approx(1.0, abs=0.02)


def test_the_noise_it_learns_is_the_mean_power_of_the_pauses():
    white = 0.01 * np.random.default_rng(4).standard_normal((16000, 2))
    component = NoiseReduction(memory_s=5.0)
    state, _ = component.process(component.start(RATE_HZ, 2), white)
    expected = np.sum(state.root**2) * 1e-4  # of white noise in a windowed transform
    inner = state.noise.power[2:-2] / expected
    assert inner.mean() == pytest.approx(1.0, abs=0.05)
    assert inner.std() < 0.15


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: NoiseReduction("median"), "'wiener' or 'subtraction'"),
        (lambda: NoiseReduction(floor=1.5), "floor is 1.5"),
        (lambda: NoiseReduction(frame_s=0.0), "frame_s is 0.0"),
    ],
)
def test_impossible_parameters_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_a_frame_of_no_length_at_this_rate_is_refused():
    with pytest.raises(SetupError, match="8 are needed"):
        NoiseReduction(frame_s=0.0005).start(RATE_HZ, 1)
