"""Reflection coefficients from reverberation times, against rooms rendered by the image method."""

import numpy as np
import pytest
from scipy.signal import butter, sosfilt

from sonobench.acoustics.image_sources import build_lattice
from sonobench.acoustics.path_render import impulse_responses
from sonobench.scene.reverberation import decay_time, uniform_reflection


def test_the_coefficient_gives_back_its_reverberation_time():
    size = np.array([5.0, 4.0, 2.7])
    for t60 in (0.1, 0.3, 1.0):
        assert decay_time(size, uniform_reflection(size, t60, 343.0), 343.0) == pytest.approx(t60, rel=1e-9)


@pytest.mark.parametrize(("size", "t60"), [((5.0, 4.0, 2.7), 0.25), ((3.0, 3.0, 3.0), 0.2), ((8.0, 3.0, 2.5), 0.3)])
def test_rendered_rooms_decay_as_asked(size, t60):
    size, rate, rng = np.array(size), 8000, np.random.default_rng(0)
    walls = np.full(6, uniform_reflection(size, t60, 343.0))
    places = rng.uniform(0.5, size - 0.5, (7, 3))
    responses = impulse_responses(build_lattice(size, walls), places[:3], places[3:], rate, 343.0, round(1.2 * t60 * rate))
    band = butter(4, [500, 3500], "band", fs=rate, output="sos")  # equal walls add up coherently at the lowest frequencies
    energy = np.square(sosfilt(band, responses.reshape(12, -1), axis=-1)).mean(axis=0)
    decay_db = -10 * np.log10(np.cumsum(energy[::-1])[::-1] / energy.sum())
    measured = 2 * np.diff(np.interp([5.0, 35.0], decay_db, np.arange(len(decay_db)) / rate))[0]
    assert measured == pytest.approx(t60, rel=0.06)


def test_a_time_that_is_not_positive_is_refused():
    with pytest.raises(ValueError, match="a positive time is needed"):
        uniform_reflection(np.ones(3), 0.0, 343.0)
