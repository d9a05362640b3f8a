"""Steered power of 28 pairs by table look-up against steering phases, tables included, and the look-ups alone."""

from __future__ import annotations

import numpy as np
from bench_clock import in_turn
from signal_sounds import RATE_HZ, WALLS_M, every_pair, free_field, header
from steering_direct import phase_steered

from sonobench.signal import plan_tables, steering
from sonobench.types import DelayTable
from sonobench_plugins.delay.phat import Phat
from sonobench_plugins.front_end.gcc_peaks import GccPeaks

PAIRS = every_pair(8)
FRAME = free_field(4, [[1.3, 1.1, 1.5]], WALLS_M, seconds=0.3)[200:712]
SETUP, _ = GccPeaks(pairs="all").open(header(WALLS_M, PAIRS))
PLAN = plan_tables(PAIRS, RATE_HZ, "hamming", 512, 0.013, None, 8)
STEERING = steering(SETUP, range(28))


def _points(n: int) -> np.ndarray:
    rng = np.random.default_rng(1)
    return np.c_[rng.uniform(0.2, 3.8, n), rng.uniform(0.2, 2.8, n), np.full(n, 1.5)]


def _tables() -> DelayTable:
    return DelayTable(PLAN.tables(Phat(), PLAN.spectra(FRAME[None]))[0], PLAN.start_s, PLAN.step_s)


def test_steered_power_of_300_points_beside_phase_steering(benchmark):
    points = _points(300)
    benchmark(lambda: STEERING.sums(_tables(), points))
    ours, direct = in_turn(
        30,
        lambda: STEERING.sums(_tables(), points),
        lambda: phase_steered(PLAN, PLAN.spectra(FRAME[None])[0], WALLS_M, PAIRS, points, 343.0, RATE_HZ),
    )
    benchmark.extra_info.update(ms=ours * 1e3, direct_ms=direct * 1e3, ratio=direct / ours)
    assert direct > 15 * ours


def test_look_ups_of_3000_points(benchmark):
    table, points = _tables(), _points(3000)
    benchmark(lambda: STEERING.sums(table, points))
