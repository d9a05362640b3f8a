"""Delay tables against nothing but their transforms: one forward a microphone, one inverse a pair."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.fft import irfft, rfft
from signal_sounds import every_pair

from sonobench.signal import GROUP, plan_tables
from sonobench_plugins.delay.phat import Phat

_LENGTH = 1024


def _bare(frames: np.ndarray, spectra: np.ndarray) -> None:
    rfft(frames, 2 * _LENGTH)
    irfft(spectra)


def _fastest(call: Callable[[], object], repeats: int = 60) -> float:
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


@pytest.mark.parametrize("mics", [2, 4, 8])
def test_delay_tables_of_a_group_of_frames(benchmark, mics):
    pairs, rng = every_pair(mics), np.random.default_rng(0)
    frames = rng.standard_normal((GROUP, _LENGTH, mics)).astype(np.float32)
    plan = plan_tables(pairs, 16000.0, "hann", _LENGTH, 1e-3, None, 4)
    bare_in = np.ascontiguousarray(frames.swapaxes(1, 2))
    bare_spectra = np.ones((GROUP, len(pairs), _LENGTH + 1), np.complex64)
    benchmark(lambda: plan.tables(Phat(), plan.spectra(frames)))
    ours = _fastest(lambda: plan.tables(Phat(), plan.spectra(frames)))
    bare = _fastest(lambda: _bare(bare_in, bare_spectra))
    each = GROUP * len(pairs) / 1e6
    benchmark.extra_info.update(us_per_frame_pair=ours / each, bare_us_per_frame_pair=bare / each, ratio=ours / bare)
    assert ours < 3 * bare
