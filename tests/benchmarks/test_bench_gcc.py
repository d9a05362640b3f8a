"""Delay tables against nothing but their transforms, one forward a microphone, one inverse a pair; and what averages cost a front end."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import pytest
from bench_clock import in_turn
from scipy.fft import irfft, rfft
from signal_sounds import WALL_PAIRS, WALLS_M, every_pair, header, scans

from sonobench.protocols import Delay
from sonobench.signal import GROUP, plan_tables
from sonobench_plugins.activity.always import Always
from sonobench_plugins.delay.ht import Ht
from sonobench_plugins.delay.iphat import Iphat
from sonobench_plugins.delay.phat import Phat
from sonobench_plugins.delay.rho_phat import RhoPhat
from sonobench_plugins.delay.scot import Scot
from sonobench_plugins.delay.subtracted_phat import SubtractedPhat
from sonobench_plugins.front_end.gcc_peaks import GccPeaks

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


AVERAGED: dict[str, Delay] = {
    "rho-phat": RhoPhat(),
    "iphat, 2 segments": Iphat(segments=2),
    "iphat, 7 segments": Iphat(),
    "iphat, 7 segments, memory": Iphat(memory_s=0.2),
    "scot, 7 segments": Scot(),
    "ht, 7 segments": Ht(),
    "subtracted-phat": SubtractedPhat(),
}


@pytest.mark.parametrize("name", AVERAGED)
def test_four_pairs_through_a_front_end_that_averages_spectra(benchmark, name):
    recording, frames = header(WALLS_M, WALL_PAIRS), 8 * GROUP
    sound = np.random.default_rng(1).standard_normal((frames * _LENGTH // 2 + _LENGTH // 2, len(WALLS_M))).astype(np.float32)
    plain, averaged = (GccPeaks(delay=delay, activity=Always()) for delay in (Phat(), AVERAGED[name]))
    assert len(scans(averaged, recording, sound)[1]) == frames
    own_s, plain_s = in_turn(9, lambda: scans(averaged, recording, sound), lambda: scans(plain, recording, sound))
    benchmark.pedantic(lambda: scans(averaged, recording, sound), rounds=3)
    benchmark.extra_info.update(ms_per_frame=1e3 * own_s / frames, phat_ms_per_frame=1e3 * plain_s / frames, ratio=own_s / plain_s)
    assert own_s < 8 * plain_s
