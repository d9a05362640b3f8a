"""Fractional delays."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench.acoustics.fractional_delay import LEAD, PHASES, TAPS, pulse_table, windowed_sinc
from sonobench.acoustics.image_sources import free_field
from sonobench.acoustics.path_render import impulse_responses


def test_a_whole_delay_is_one_sample():
    np.testing.assert_allclose(pulse_table()[0], np.eye(TAPS)[LEAD], atol=1e-7)


def test_rows_interpolate_to_the_stated_accuracy():
    fraction = (np.arange(PHASES) + 0.5) / PHASES
    exact = windowed_sinc(np.arange(TAPS) - LEAD - fraction[:, None])
    middle = 0.5 * (pulse_table()[1:] + pulse_table()[:-1])
    assert 20 * np.log10(np.abs(middle - exact).max()) <= -94.0


@pytest.mark.parametrize("share", [0.1, 0.5, 0.8, 0.9])
def test_a_sine_below_nine_tenths_of_the_band_is_delayed_and_nothing_else(share):
    distance = np.linspace(1.0, 1.05, 23)  # some 2.3 samples apart, in fractions
    positions = np.stack([distance, 0 * distance, 0 * distance], axis=-1)
    h = impulse_responses(free_field(), positions, np.zeros((1, 3)), 16000.0, 343.0, 200)[:, 0].astype(float)
    omega = np.pi * share
    response = (h * np.exp(-1j * omega * (np.arange(200) - LEAD))).sum(axis=-1)
    expected = np.exp(-1j * omega * distance / 343.0 * 16000.0) / (4 * np.pi * distance)
    assert np.abs(response / expected - 1).max() <= 2e-3


def test_a_pulse_changes_without_steps_as_its_delay_crosses_a_sample():
    sample_m = 343.0 / 16000.0
    positions = np.array([[50 * sample_m * (1 - 1e-9), 0, 0], [50 * sample_m * (1 + 1e-9), 0, 0]])
    before, after = impulse_responses(free_field(), positions, np.zeros((1, 3)), 16000.0, 343.0, 200)[:, 0]
    assert np.abs(before - after).max() <= 1e-6 * np.abs(before).max()
