import numpy as np
import pytest
from signal_sounds import RATE_HZ, delayed

from sonobench_plugins.delay.phat import Phat


@pytest.mark.parametrize("lag", [-7, 0, 3, 12])
def test_the_peak_lies_at_the_lag_by_which_i_is_later(lag):
    x = delayed(np.random.default_rng(3).standard_normal(256), np.array([lag, 0]) / RATE_HZ)
    spectra = np.fft.rfft(x.T)[None]
    spectra.flags.writeable = False
    table = Phat().correlate(spectra, np.array([[0, 1], [1, 0]]))
    assert table.shape == (1, 2, 256)
    assert table.argmax(-1).tolist() == [[lag % 256, -lag % 256]]
    assert table[0, 0, lag % 256] == pytest.approx(1.0, abs=1e-3)


def test_whitening_once_a_microphone_equals_whitening_each_pair():
    rng = np.random.default_rng(4)
    spectra = rng.standard_normal((2, 3, 65)) + 1j * rng.standard_normal((2, 3, 65))
    pairs = np.array([[0, 1], [2, 0], [1, 2]])
    g = spectra[..., pairs[:, 0], :] * spectra[..., pairs[:, 1], :].conj()
    assert np.allclose(Phat().correlate(spectra, pairs), np.fft.irfft(g / np.abs(g)), atol=1e-12)


def test_lags_are_those_of_pyroomacoustics():
    pra = pytest.importorskip("pyroomacoustics")
    rng = np.random.default_rng(5)
    for lag in rng.integers(-20, 21, 10):  # pra: positive where its first signal is the later, as here
        x = delayed(rng.standard_normal(512), np.array([lag, 0]) / RATE_HZ)
        table = Phat().correlate(np.fft.rfft(x.T, 1024)[None], np.array([[0, 1]]))[0, 0]
        ours = (int(table.argmax()) + 512) % 1024 - 512
        assert ours == round(pra.tdoa(x[:, 0], x[:, 1], fs=RATE_HZ, phat=True) * RATE_HZ)


def test_silence_correlates_to_zero():
    assert not Phat().correlate(np.zeros((1, 2, 17), np.complex64), np.array([[0, 1]])).any()
