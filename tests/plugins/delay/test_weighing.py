"""Estimators that weigh averaged spectra: their limits, the coherence by a second route, and frames through a front end."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path

import numpy as np
import pytest

from sonobench.errors import SetupError
from sonobench.pipeline import scans_of
from sonobench.signal import coherence, cross_spectra, plan_tables, snr_exponent
from sonobench.testing import check, fixtures
from sonobench_plugins.activity.always import Always
from sonobench_plugins.delay.cc import Cc
from sonobench_plugins.delay.ht import Ht
from sonobench_plugins.delay.iphat import Iphat
from sonobench_plugins.delay.phat import Phat
from sonobench_plugins.delay.rho_phat import RhoPhat
from sonobench_plugins.delay.roth import Roth
from sonobench_plugins.delay.scot import Scot
from sonobench_plugins.delay.subtracted_phat import SubtractedPhat
from sonobench_plugins.front_end.gcc_peaks import GccPeaks

PAIRS = np.array([[0, 1], [2, 0]])
ESTIMATORS = [Cc(), Roth(), Scot(), Ht(), RhoPhat(), RhoPhat(adapt=True, segments=7), Iphat(), Iphat(adapt=True), SubtractedPhat()]


def noisy(n: int = 1024, snr_db: float = 10.0, seed: int = 0, frames: int = 1) -> np.ndarray:
    """(frames, n, 3): one coloured source, microphone 1 hears it 3 samples before 0, microphone 2 with it; independent noise."""
    rng = np.random.default_rng(seed)
    source = np.convolve(rng.standard_normal(frames * n + 64), [1, 0.9, 0.5], "same")
    delayed = np.stack([np.roll(source, s)[32 : 32 + frames * n] for s in (3, 0, 3)], axis=-1)
    noise = rng.standard_normal(delayed.shape) * source.std() * 10 ** (-snr_db / 20)
    out = (delayed + noise).reshape(frames, n, 3).astype(np.float32)
    out.flags.writeable = False
    return out


def spectra(**more):
    return np.fft.rfft(noisy(**more), axis=1).swapaxes(1, 2).astype(np.complex64)


def test_limits_of_the_exponent_are_cross_correlation_and_the_phase_transform():
    x = spectra()
    np.testing.assert_allclose(RhoPhat(alpha=0.0).correlate(x, PAIRS), Cc().correlate(x, PAIRS), atol=1e-5)
    np.testing.assert_allclose(RhoPhat(alpha=1.0).correlate(x, PAIRS), Phat().correlate(x, PAIRS), atol=1e-5)


def test_of_one_periodogram_scot_is_the_phase_transform_and_the_coherence_one():
    x = spectra()
    np.testing.assert_allclose(Scot().correlate(x, PAIRS), Phat().correlate(x, PAIRS), atol=1e-5)
    np.testing.assert_allclose(coherence(cross_spectra(x, PAIRS), np.abs(x) ** 2, PAIRS), 1.0, rtol=1e-5)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_the_recordings_level_changes_nothing(estimator):
    plan = plan_tables(PAIRS, 8000.0, "hann", 1024, 0.002, None, 4)
    x = noisy()
    quiet, loud = (plan.welch(np.float32(g) * x, 7) for g in (1e-3, 1.0))
    a, b = (plan.weighted_tables(estimator.weigh(cross, power, PAIRS)) for cross, power in (quiet, loud))
    np.testing.assert_allclose(a, b, atol=2e-5)


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=lambda e: type(e).__name__)
def test_a_source_is_found_where_it_is_and_a_table_is_at_most_one(estimator):
    plan = plan_tables(PAIRS, 8000.0, "hann", 1024, 0.002, None, 4)
    found = plan.weighted_tables(estimator.weigh(*plan.welch(noisy(snr_db=10.0), 7), PAIRS))[0]
    lag = (plan.start_s + plan.step_s * found.argmax(axis=1)) * 8000
    np.testing.assert_allclose(lag, [3, 0], atol=0.2)
    assert found.max() <= 1.01


def test_averages_of_segments_are_welchs_as_scipy_has_them():
    from scipy.signal import csd, get_window

    x = noisy()[0].astype(float)
    plan = plan_tables(PAIRS, 8000.0, "rectangular", 1024, 0.002, None, 4)
    cross, power = plan.welch(x[None].astype(np.float32), 7)
    low, high = plan.band[0], plan.band[1] - 1  # SciPy counts the last bin once
    kept = {
        "window": get_window("boxcar", 256),
        "nperseg": 256,
        "noverlap": 128,
        "nfft": plan.fft_length,
        "detrend": False,
        "scaling": "spectrum",
    }
    theirs = np.array([csd(x[:, j], x[:, i], **kept)[1] for i, j in PAIRS])
    ratio = cross[0][:, low:high] / theirs[:, low:high]
    np.testing.assert_allclose(ratio, ratio[0, 5], rtol=2e-3)
    own = np.array([csd(x[:, i], x[:, i], **kept)[1] for i in range(3)]).real
    gamma = np.abs(theirs) ** 2 / np.array([own[i] * own[j] for i, j in PAIRS])
    np.testing.assert_allclose(coherence(cross, power, PAIRS)[0][:, low:high], gamma[:, low:high], atol=2e-3)


def test_coherence_falls_with_noise_and_the_exponent_with_it():
    plan = plan_tables(PAIRS, 8000.0, "hann", 1024, 0.002, None, 4)
    mean = [
        float(np.mean(coherence(*plan.welch(noisy(snr_db=s, frames=8), 15), PAIRS)[..., plan.band[0] : plan.band[1]]))
        for s in (40, 10, -20)
    ]
    assert 1 > mean[0] > mean[1] > mean[2] > 0
    assert mean[2] < 0.25


@pytest.mark.parametrize(("snr_db", "alpha"), [(0.0, 0.5), (5.0, 0.5), (15.0, 0.75), (20.0, 0.75), (32.0, 0.85)])
def test_the_exponent_follows_the_ratio_by_table_3_4_also_where_most_bins_hold_noise(snr_db, alpha):
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft(rng.standard_normal((1, 65536)))
    spectrum[:, spectrum.shape[1] // 8 :] = 0  # an eighth of the band
    source = np.fft.irfft(spectrum)[0]
    heard = np.stack([np.roll(source, s) for s in (3, 0, 3)], axis=-1)
    noise = rng.standard_normal(heard.shape) * source.std() * 10 ** (-snr_db / 20)
    plan = plan_tables(PAIRS, 8000.0, "hann", 1024, 0.002, None, 4)
    found = snr_exponent(*plan.welch((heard + noise).reshape(64, 1024, 3).astype(np.float32), 7), PAIRS)
    assert found.shape == (64, 2, 1)
    assert np.median(found) == np.float32(alpha)


@pytest.mark.parametrize("estimator", [Cc(memory_s=0.3), Iphat(memory_s=0.2), Ht(segments=3), Scot()], ids=lambda e: type(e).__name__)
def test_blocks_of_any_length_give_the_same_scans(estimator):
    front_end = GccPeaks(delay=estimator, activity=Always(), frame_s=0.064, hop_s=0.032)
    whole, cut = (
        scans_of(front_end, fixtures.sampled(lengths=lengths), fixtures.given())[1] for lengths in ((100_000,), (1, 700, 31, 5000))
    )
    assert len(whole) > 8
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(a.fields["gcc"].values, b.fields["gcc"].values)


def test_a_memory_averages_cross_spectra_so_that_noise_gives_way():
    x = noisy(snr_db=-12.0, frames=64)
    plan = plan_tables(PAIRS, 8000.0, "hann", 1024, 0.002, None, 4)
    cross, power = plan.welch(x, 1)
    one = plan.weighted_tables(Cc().weigh(cross, power, PAIRS))
    many = plan.weighted_tables(Cc().weigh(cross.mean(axis=0, keepdims=True), power.mean(axis=0, keepdims=True), PAIRS))
    right = plan.start_s + plan.step_s * many[0, 0].argmax()
    assert abs(right * 8000 - 3) < 0.6
    wrong = np.abs(plan.start_s + plan.step_s * one[:, 0].argmax(axis=1) - 3 / 8000) * 8000 > 1
    assert wrong.mean() > 0.2


def test_segments_too_short_for_the_delays_and_nonsense_are_refused():
    with pytest.raises(SetupError, match=r"31 segments of a frame of .* too short for delays"):
        scans_of(GccPeaks(delay=Scot(segments=31), frame_s=0.032, hop_s=0.032), fixtures.sampled(), {})
    with pytest.raises(SetupError, match="segments is 0"):
        scans_of(GccPeaks(delay=Scot(segments=0)), fixtures.sampled(), {})
    with pytest.raises(ValueError, match="adapt estimates"):
        RhoPhat(adapt=True)
    with pytest.raises(ValueError, match="alpha is 2"):
        Iphat(alpha=2.0)


def test_the_estimator_of_the_plugin_page_holds_every_claim(monkeypatch):
    page = (Path(__file__).parents[3] / "docs" / "plugins.md").read_text("utf-8")
    (source,) = re.findall(r"```python\n(.*?class CoherentPhat.*?)```", page.split("## Delay estimators")[1], re.DOTALL)
    module = types.ModuleType("coherent_phat")
    monkeypatch.setitem(sys.modules, "coherent_phat", module)
    exec(source, vars(module))
    findings = check(module.CoherentPhat(), "delay")
    assert {f.sentence for f in findings if f.check.startswith("delay.") and f.result != "ok"} == set()
