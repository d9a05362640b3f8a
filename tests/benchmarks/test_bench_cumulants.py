"""Moments of a frame of 10000 snapshots beside the bare product of its channels, spectra at particles, directions of five sources."""

from __future__ import annotations

import time

import numpy as np
import pytest
from vector_sources import heard, spread

from sonobench.signal.cumulants import PAIRS, moments
from sonobench_plugins.direction.cumulant_peaks import CumulantPeaks
from sonobench_plugins.direction.gls import Gls
from sonobench_plugins.spectrum.cumulant import CumulantSpectrum


def _frame(m: int = 5) -> np.ndarray:
    rng = np.random.default_rng(m)
    return heard(rng, spread(rng, m, 35))[None].astype(np.float32)


def _fastest(call, repeats: int = 40) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


@pytest.mark.parametrize("error", [False, True], ids=["cumulants", "with-sampling-covariance"])
def test_moments_of_10000_snapshots(benchmark, error):
    samples = _frame()
    benchmark(lambda: moments(samples, error=error))
    pairs = np.ones((45 if error else 10, samples.shape[1]))
    bare = _fastest(lambda: pairs @ pairs.T)
    benchmark.extra_info.update(ratio_to_bare_product=_fastest(lambda: moments(samples, error=error)) / bare)


def test_35_cumulants_beside_one_mean_each(benchmark):
    samples = _frame()[0].T.astype(float)

    def one_by_one() -> None:
        products = {(i, j): samples[i] * samples[j] for i, j in PAIRS.tolist()}
        for i, j in PAIRS.tolist():
            for k, l in PAIRS.tolist():
                if (k, l) >= (i, j):
                    np.mean(products[i, j] * products[k, l])

    benchmark(lambda: moments(_frame_of(samples)))
    ratio = _fastest(one_by_one, 10) / _fastest(lambda: moments(_frame_of(samples)))
    benchmark.extra_info.update(times_faster=ratio)
    assert ratio > 1


def _frame_of(samples: np.ndarray) -> np.ndarray:
    return samples.T[None]


@pytest.mark.parametrize("particles", [1000, 5000])
def test_a_spectrum_at_particles(benchmark, particles):
    field = CumulantSpectrum().fields(_frame())[0]
    z = np.random.default_rng(0).normal(size=(particles, 1, 2))
    q = np.array([0])
    benchmark(lambda: field.at(z, q))


@pytest.mark.parametrize(
    "method", [CumulantSpectrum().fields, CumulantPeaks().directions, Gls().directions], ids=["spectrum", "peaks", "gls"]
)
def test_a_frame_of_five_sources(benchmark, method):
    samples = _frame()
    benchmark(lambda: method(samples))
