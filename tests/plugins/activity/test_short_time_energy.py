"""End-point detection by short-time energy: eq. 2-2 against a loop, and both thresholds on envelopes made for them."""

import numpy as np
import pytest

from sonobench import SetupError
from sonobench_plugins.activity.short_time_energy import ShortTimeEnergy


def _square(levels, length=400, channels=2):
    """Frames of constant magnitude, whose energy is exact: level² at every window."""
    frames = np.ones((len(levels), length, channels)) * np.array(levels)[:, None, None]
    frames[:, ::2] *= -1
    frames.flags.writeable = False
    return frames


def _run(detector, frames):
    return detector.active(detector.start(8000.0), frames)[1].tolist()


def test_the_energy_is_the_windowed_sum_of_the_definition_over_its_length():
    frames = np.random.default_rng(0).standard_normal((3, 130, 2))
    found = ShortTimeEnergy(window_samples=100).energy(frames)
    assert found.shape == (3, 31)
    for f in range(3):
        for n in range(31):
            assert found[f, n] == pytest.approx(np.mean(frames[f, n : n + 100] ** 2), rel=1e-9)


def test_the_largest_energy_times_alpha_is_the_threshold():
    """Amplitudes over the record: .32 has .1024 of its energy, .31 has .0961."""
    levels = [0.01, 1.0, 0.32, 0.31, 2.0, 0.62, 0.64, 0.0]
    assert _run(ShortTimeEnergy(), _square(levels)) == [True, True, True, False, True, False, True, False]
    assert _run(ShortTimeEnergy(alpha=0.05), _square(levels)) == [True, True, True, True, True, True, True, False]


def test_the_smallest_energy_plus_ten_decibels_is_the_threshold():
    """Amplitudes over the record: 3.17 is 10.02 dB above it, 3.15 is 9.97 dB."""
    levels = [0.1, 0.317, 0.315, 0.01, 0.0317, 0.0315, 0.5]
    assert _run(ShortTimeEnergy("minimum"), _square(levels)) == [False, True, False, False, True, False, True]


def test_a_sound_shorter_than_a_frame_counts_and_a_shorter_window_sees_it_better():
    frames = np.array(_square([1.0, 0.01]))
    frames[1, 150:250] = 1.0  # one window of the loudest, a quarter of the frame
    assert _run(ShortTimeEnergy(alpha=0.5), frames) == [True, True]
    assert _run(ShortTimeEnergy(alpha=0.5, window_samples=0), frames) == [True, False]


def test_a_record_known_beforehand_keeps_the_noise_before_the_first_sound_out():
    levels = [0.01, 0.01, 1.0, 0.01]
    assert _run(ShortTimeEnergy(), _square(levels)) == [True, True, True, False]
    assert _run(ShortTimeEnergy(record_db=0.0), _square(levels)) == [False, False, True, False]


def test_digital_silence_is_no_sound_and_no_record_of_noise():
    levels = [0.0, 0.0, 0.1, 0.05, 0.0, 0.4]
    assert _run(ShortTimeEnergy("minimum"), _square(levels)) == [False, False, False, False, False, True]


def test_rules_agree_with_a_loop_over_random_envelopes():
    levels = 10 ** np.random.default_rng(1).uniform(-3, 0, 60)
    most, least, expected = 0.0, np.inf, {"maximum": [], "minimum": []}
    for energy in levels**2:
        most, least = max(most, energy), min(least, energy)
        expected["maximum"].append(bool(energy >= 0.1 * most))
        expected["minimum"].append(bool(energy >= 10 * least))
    for rule, active in expected.items():
        assert _run(ShortTimeEnergy(rule), _square(levels)) == active
        assert 5 < sum(active) < 59


def test_a_window_longer_than_the_frame_is_refused():
    with pytest.raises(SetupError, match="at most a frame's 400, got 500"):
        _run(ShortTimeEnergy(window_samples=500), _square([1.0]))


@pytest.mark.parametrize("parameters", [{"rule": "median"}, {"alpha": 0.0}, {"above_db": -1.0}, {"window_samples": -1}])
def test_impossible_parameters_are_refused(parameters):
    with pytest.raises(ValueError, match="needed"):
        ShortTimeEnergy(**parameters)
