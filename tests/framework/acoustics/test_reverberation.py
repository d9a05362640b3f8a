"""Reverberation times measured of responses."""

from __future__ import annotations

import numpy as np
import pytest
from acoustics_decay import energy_decay_db, reverberation_time
from scipy.signal import butter, sosfilt

from sonobench.acoustics.image_sources import build_lattice
from sonobench.acoustics.path_render import impulse_responses, response_length
from sonobench.scene.reverberation import uniform_reflection

RATE = 8000.0


@pytest.mark.parametrize("t60_s", [0.15, 0.6])
def test_noise_that_decays_by_60_db_in_t60_has_that_time(t60_s):
    t = np.arange(round(1.5 * t60_s * RATE)) / RATE
    response = np.random.default_rng(1).normal(size=len(t)) * 10 ** (-3 * t / t60_s)
    response.flags.writeable = False
    assert reverberation_time(response, RATE) == pytest.approx(t60_s, rel=0.1)


def test_the_decay_starts_at_0_db_and_never_rises():
    decay = energy_decay_db(np.random.default_rng(2).normal(size=500))
    assert decay[0] == 0.0
    assert (np.diff(decay) <= 0).all()


@pytest.mark.parametrize("box", [(6.0, 5.0, 2.7), (3.0, 3.0, 2.5)])
@pytest.mark.parametrize("t60_s", [0.2, 0.35])
def test_walls_calibrated_to_a_time_have_it_above_100_hz(box, t60_s):
    # all images have one sign, so they pile up at 0 Hz, which a box of air does not pass on and no loudspeaker emits
    b = uniform_reflection(np.array(box), t60_s, 343.0)
    lattice = build_lattice(box, [b] * 6, prune_db=-55.0)
    rng = np.random.default_rng(3)
    positions, mics = rng.uniform(0.5, np.array(box) - 0.5, (2, 2, 3))
    length = response_length(lattice, positions, mics, RATE, 343.0)
    responses = impulse_responses(lattice, positions, mics, RATE, 343.0, length).reshape(4, -1)
    high = butter(2, 100.0, "high", fs=RATE, output="sos")
    measured = np.mean([reverberation_time(sosfilt(high, r), RATE) for r in responses])
    assert measured == pytest.approx(t60_s, rel=0.08)


def test_responses_without_a_measurable_decay_are_refused():
    for response, said in ((np.zeros(100), "silent"), (np.ones(1000), "is cut"), (np.eye(1, 1000)[0], "no reverberation")):
        with pytest.raises(ValueError, match=said):
            reverberation_time(response, RATE)
