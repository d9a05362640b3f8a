"""Frequency selection: what is kept is what all pairs agree holds signal."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench_plugins.delay.selected_phat import SelectedPhat

BINS, MICS = 257, 4
PAIRS = np.array([[0, 1], [2, 3]])


def averaged(snr: np.ndarray, delays: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Exact averages of a source of power `snr` (bin,) in noise of power 1, pair p being `delays[p]` samples late."""
    phase = np.exp(-2j * np.pi * np.arange(BINS) / 512 * delays[:, None])
    return (snr * phase).astype(np.complex64), np.broadcast_to(snr + 1, (MICS, BINS)).astype(np.float32)


def test_a_bin_stays_where_the_ratio_reaches_eta_and_keeps_its_phase() -> None:
    snr = 10 ** (np.linspace(-20, 20, BINS) / 10)
    cross, power = averaged(snr, np.array([3.0, -7.0]))
    out = SelectedPhat(eta_db=6.0).weigh(cross, power, PAIRS)
    kept = 10 * np.log10(snr) >= 6.0
    np.testing.assert_allclose(np.abs(out), np.broadcast_to(kept, out.shape), atol=1e-5)
    np.testing.assert_allclose(np.angle(out[:, kept]), np.angle(cross[:, kept]), atol=1e-5)


def test_without_a_threshold_it_is_the_phase_transform() -> None:
    cross, power = averaged(np.linspace(0.1, 3, BINS), np.array([3.0, -7.0]))
    out = SelectedPhat(eta_db=-300.0).weigh(cross, power, PAIRS)
    np.testing.assert_allclose(out, cross / np.abs(cross), atol=1e-5)


def test_the_printed_average_of_complex_spectra_drops_what_differs_in_delay() -> None:
    cross, power = averaged(np.full(BINS, 100.0), np.array([40.0, -40.0]))
    here = np.count_nonzero(SelectedPhat(eta_db=10.0).weigh(cross, power, PAIRS)[0])
    printed = np.count_nonzero(SelectedPhat(eta_db=10.0, average="complex").weigh(cross, power, PAIRS)[0])
    assert here == BINS
    assert 0 < printed < 0.6 * BINS


def test_noise_alone_is_silence_and_not_nan() -> None:
    cross, power = averaged(np.zeros(BINS), np.zeros(2))
    assert not SelectedPhat().weigh(cross, power, PAIRS).any()


@pytest.mark.parametrize("faulty", [{"segments": 1}, {"average": "mean"}])
def test_parameters_that_make_no_sense_are_refused(faulty: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"need(ed|s)"):
        SelectedPhat(**faulty)  # type: ignore[arg-type]
