"""Delay tables (GCC-PHAT) beside the bare transforms they cannot do without, in microseconds a frame and pair.

Bare: one forward transform a microphone and one inverse a pair, of zero-padded frames (1024 → 2048, float32), in the groups of
frames that the front end uses; neither windowing nor whitening nor products. Ours: the delay tables from frames (windows, spectra, whitening,
products, inverse, interpolation of the lags within reach), and the whole front end from blocks to scans (also cutting, activity, peaks).
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
import scipy.fft
from bench_clock import in_turn

from sonobench.signal import GROUP, plan_tables
from sonobench.types import Block, Header, MicArray
from sonobench_plugins.activity.always import Always
from sonobench_plugins.delay.phat import Phat
from sonobench_plugins.front_end.gcc_peaks import GccPeaks

RATE_HZ, LENGTH, GROUPS, C = 16000.0, 1024, 24, 343.0


def rig(mics):
    """Microphones 5 cm apart and every pair of them."""
    elements = np.c_[0.05 * np.arange(mics), np.zeros((mics, 2))]
    return elements, np.array(list(combinations(range(mics), 2)))


@pytest.mark.parametrize("band_hz", [None, (100.0, 4000.0)], ids=["whole band", "100 to 4000 Hz"])
@pytest.mark.parametrize("mics", [2, 4, 8])
def test_delay_tables_beside_the_bare_transforms(benchmark, mics, band_hz):
    elements, pairs = rig(mics)
    frames = np.random.default_rng(mics).normal(size=(GROUPS, GROUP, LENGTH, mics)).astype(np.float32)
    plan = plan_tables(pairs, RATE_HZ, "hann", LENGTH, float(elements[-1, 0] / C), None if band_hz is None else np.array(band_hz), 4)
    padded = np.zeros((GROUPS, GROUP, mics, plan.fft_length), np.float32)
    padded[..., :LENGTH] = frames.swapaxes(2, 3)
    products = np.ones((GROUP, len(pairs), plan.fft_length // 2 + 1), np.complex64)
    delay = Phat()

    def bare():
        for group in padded:
            scipy.fft.rfft(group)
            scipy.fft.irfft(products)

    def tables():
        for group in frames:
            plan.tables(delay, plan.spectra(group))

    header = Header(
        "bench",
        (MicArray("row", "microphones", elements, RATE_HZ, pairs=pairs),),
        np.eye(4)[None],
        duration_s=GROUPS * GROUP * LENGTH / 2 / RATE_HZ,
        band_hz=band_hz,
    )
    front_end = GccPeaks(frame_s=LENGTH / RATE_HZ, hop_s=LENGTH / 2 / RATE_HZ, activity=Always())
    sound = np.random.default_rng(1).normal(size=(GROUPS * GROUP * LENGTH // 2 + LENGTH // 2, mics)).astype(np.float32)
    blocks = [Block("row", at, sound[at : at + 1600]) for at in range(0, len(sound), 1600)]

    def whole():
        _, state = front_end.open(header)
        count = 0
        for block in blocks:
            state, scans = front_end.step(state, block)
            count += len(scans)
        return count + len(front_end.flush(state))

    assert whole() == GROUPS * GROUP
    bare_s, tables_s, whole_s = in_turn(15, bare, tables, whole)
    benchmark.pedantic(tables, rounds=3)
    unit = 1e6 / (GROUPS * GROUP * len(pairs))
    benchmark.extra_info |= {
        "pairs": len(pairs),
        "bare transforms (us)": bare_s * unit,
        "delay tables (us)": tables_s * unit,
        "whole front end (us)": whole_s * unit,
        "tables / bare": tables_s / bare_s,
        "whole / bare": whole_s / bare_s,
        "whole, times real time": GROUPS * GROUP * LENGTH / 2 / RATE_HZ / whole_s,
    }
    assert tables_s < 4 * bare_s
