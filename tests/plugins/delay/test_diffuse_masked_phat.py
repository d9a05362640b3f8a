"""The ratio of coherent to diffuse sound, from the coherence that a mixture of both has."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from signal_sounds import RATE_HZ, WALL_PAIRS, WALLS_M, header

from sonobench_plugins.delay.diffuse_masked_phat import BoundMask, DiffuseMaskedPhat, coherent_to_diffuse
from sonobench_plugins.front_end.gcc_peaks import GccPeaks


@given(st.floats(-0.95, 0.95), st.floats(-3.1, 3.1), st.floats(0.01, 100.0))
def test_the_ratio_of_a_mixture_comes_back_whatever_the_direction(diffuse: float, phase: float, ratio: float) -> None:
    mixture = (ratio * np.exp(1j * phase) + diffuse) / (ratio + 1)
    found = coherent_to_diffuse(np.array([[mixture]]), np.array([[diffuse]]))[0, 0]
    assert found == pytest.approx(ratio, rel=1e-4, abs=1e-6)


def test_weights_are_the_share_of_coherent_sound_and_phases_stay() -> None:
    mask = DiffuseMaskedPhat().bind(8000 / 512, np.array([0.2]), 343.0)
    f = np.arange(257) * 8000 / 512
    diffuse = np.sinc(2 * f * 0.2 / 343.0)
    ratio = np.linspace(0.2, 20, 257)
    gamma = (ratio * np.exp(-2j * np.pi * f * 3e-4) + diffuse) / (ratio + 1)
    weighed = mask.weigh(5.0 * gamma[None], np.full((2, 257), 5.0), np.array([[0, 1]]))[0]
    inner = slice(1, None)  # at 0 Hz every field is coherent
    np.testing.assert_allclose(np.abs(weighed[inner]), (ratio / (1 + ratio))[inner], rtol=2e-3)
    np.testing.assert_allclose(np.angle(weighed), np.angle(gamma), atol=1e-5)


def test_a_threshold_keeps_bins_or_drops_them() -> None:
    ratio = np.array([0.1, 1.0, 10.0])
    gamma = ratio / (ratio + 1) * np.exp(1j)
    mask = BoundMask(DiffuseMaskedPhat(threshold_db=3.0), np.array([np.inf]))
    weighed = mask.weigh(gamma[None], np.ones((2, 3)), np.array([[0, 1]]))[0]
    np.testing.assert_allclose(np.abs(weighed), [0, 0, 1], atol=1e-6)


def test_a_front_end_tells_the_estimator_where_its_microphones_are() -> None:
    _, state = GccPeaks(delay=DiffuseMaskedPhat()).open(header(WALLS_M, WALL_PAIRS))
    bound = state.stream.delay
    bin_hz = RATE_HZ / state.stream.plan.fft_length
    np.testing.assert_allclose(bound.turns, 2 * bin_hz * 0.4 / 343.0)


def test_one_periodogram_has_no_coherence() -> None:
    with pytest.raises(ValueError, match="averaged"):
        DiffuseMaskedPhat(segments=1)
