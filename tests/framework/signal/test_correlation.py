from dataclasses import dataclass

import numpy as np
import pytest
from signal_sounds import RATE_HZ, delayed, every_pair

from sonobench import PluginError, SetupError
from sonobench.signal import cross_spectra, plan_tables, whitened


@dataclass(frozen=True)
class _Plain:
    """Correlation without whitening, by the definition."""

    def correlate(self, spectra, pairs):
        return np.fft.irfft(spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj())


@dataclass(frozen=True)
class _FloorPhat:
    """The newcomer's estimator of the README."""

    floor: float = 0.1

    def correlate(self, spectra, pairs):
        g = spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj()
        return np.fft.irfft(g / (np.abs(g) + self.floor * np.median(np.abs(g), -1, keepdims=True)))


class _Flat:
    def correlate(self, spectra, pairs):
        return np.zeros((len(spectra), len(pairs)))


def _plan(band_hz=None, oversampling=4, pairs=None):
    return plan_tables(every_pair(3) if pairs is None else pairs, RATE_HZ, "hann", 512, 1e-3, band_hz, oversampling)


def _frames(seed=0, delays=(0.0, 2.4, -3.3)):
    x = delayed(np.random.default_rng(seed).standard_normal(4096), np.array(delays) / RATE_HZ)
    frames = np.stack([x[a : a + 512] for a in (0, 700, 1400)]).astype(np.float32)
    frames.flags.writeable = False
    return frames


def test_whitening_keeps_the_phase_and_leaves_zeros_alone():
    x = np.array([[3 + 4j, 0, -2, 1e-20j]], np.complex64)
    x.flags.writeable = False
    assert np.allclose(whitened(x), [[0.6 + 0.8j, 0, -1, 1j]], atol=1e-6)


def test_cross_spectra_are_i_times_conjugate_j():
    x = np.array([[1j, 2.0, 3 + 1j]]).T.astype(np.complex64)
    assert np.allclose(cross_spectra(x, np.array([[0, 1], [2, 0]]))[:, 0], [1j * 2, (3 + 1j) * -1j])


@pytest.mark.parametrize("band_hz", [None, np.array([100.0, 2000.0])])
def test_tables_are_the_inverse_transform_summed_by_hand(band_hz):
    plan, frames = _plan(band_hz), _frames()
    table = plan.tables(_Plain(), plan.spectra(frames))
    assert table.dtype == np.float32
    low, high = plan.band
    f = np.arange(low, high) * RATE_HZ / plan.fft_length
    X = np.fft.rfft(frames.swapaxes(1, 2) * plan.window.astype(float), plan.fft_length)[..., low:high]
    tau = plan.start_s + plan.step_s * np.arange(plan.columns)
    for p, (i, j) in enumerate(plan.pairs):
        weight = np.where(np.arange(low, high) == plan.bins - 1, 0.5, 1.0)
        exact = (X[:, i] * X[:, j].conj() * weight) @ np.exp(2j * np.pi * f[:, None] * tau)
        expected = exact.real / (high - low)
        assert np.abs(table[:, p] - expected).max() < 2e-3 * np.abs(expected).max()


def test_the_band_keeps_others_out_of_every_estimator():
    plan = _plan(np.array([300.0, 1800.0]))
    spectra = plan.spectra(_frames())
    f = np.arange(plan.bins) * RATE_HZ / plan.fft_length
    assert not spectra[..., (f < 300.0) | (f > 1800.0)].any()
    assert (spectra == 0).mean() < 0.4


@pytest.mark.parametrize("band_hz", [None, np.array([0.0, 1000.0]), np.array([200.0, 3000.0]), np.array([0.0, 9999.0])])
def test_the_newcomers_estimator_is_finite_and_peaks_at_the_delay(band_hz):
    plan = _plan(band_hz)
    table = plan.tables(_FloorPhat(), plan.spectra(_frames()))
    assert np.isfinite(table).all()
    peak = (plan.start_s + plan.step_s * table.argmax(-1)) * RATE_HZ
    assert np.abs(peak - np.array([-2.4, 3.3, 5.7])).max() < 0.5


def test_an_answer_of_another_shape_names_the_estimator():
    plan = _plan()
    with pytest.raises(PluginError, match=r"_Flat gave .* \(frame, pair, lag\)"):
        plan.tables(_Flat(), plan.spectra(_frames()))


def test_frames_too_short_and_empty_bands_are_refused():
    with pytest.raises(SetupError, match="raise frame_s"):
        plan_tables(every_pair(2), RATE_HZ, "hann", 64, 0.01, None, 2)
    with pytest.raises(SetupError, match="band"):
        _plan(np.array([3999.0, 8000.0]))
