"""Responses along a path of 100 positions at order 40, 2 microphones, 8 kHz, beside pyroomacoustics on one thread.

Its cheapest right use: all positions are sources of one room. Ours includes building and pruning the lattice, not
Numba's compilation (stated in `extra_info`). Run: pytest tests/benchmarks/test_bench_image_method.py --benchmark-only
"""

from __future__ import annotations

import math
import time

import numpy as np
import pytest

from sonobench.acoustics.image_sources import build_lattice, free_field
from sonobench.acoustics.path_render import LEAD, Path, impulse_responses, render_path

BOX, WALLS, ORDER = np.array([3.0, 3.0, 2.5]), (0.85, 0.85, 0.25, 0.25, 0.25, 0.25), 40
RATE, C, LENGTH = 8000, 343.0, 6000
MICS = np.array([[2.1, 0.4, 1.6], [0.9, 2.5, 0.8]])
POSITIONS = np.linspace([0.5, 0.6, 1.2], [2.5, 2.3, 1.6], 100)


def ours(prune_db=-70.0):
    lattice = build_lattice(BOX, WALLS, ORDER, prune_db)
    return impulse_responses(lattice, POSITIONS, MICS, float(RATE), C, LENGTH)


def theirs():
    pra = pytest.importorskip("pyroomacoustics")
    pra.constants.set("rir_hpf_enable", False)
    pra.constants.set("num_threads", 1)
    names = ("west", "east", "south", "north", "floor", "ceiling")
    walls = {n: pra.Material(energy_absorption=1 - w * w) for n, w in zip(names, WALLS, strict=True)}
    room = pra.ShoeBox(BOX, fs=RATE, materials=walls, max_order=ORDER)
    room.set_sound_speed(C)
    room.add_microphone_array(MICS.T)
    for position in POSITIONS:
        room.add_source(position)
    room.compute_rir()
    return room.rir


def seconds(work):
    started = time.perf_counter()
    result = work()
    return time.perf_counter() - started, result


def test_path_of_a_room_beside_pyroomacoustics(benchmark):
    compile_s, _ = seconds(ours)
    pruned = benchmark(ours)
    theirs_s, rir = seconds(theirs)
    ours_s = benchmark.stats.stats.min
    whole = ours(-math.inf).astype(float)
    error_db = 10 * np.log10((((pruned - whole) ** 2).sum(axis=-1) / (whole**2).sum(axis=-1)).max())
    late = 40 - LEAD
    reference = np.zeros_like(whole)
    for k, m in np.ndindex(len(POSITIONS), len(MICS)):
        r = np.asarray(rir[m][k][late:])[:LENGTH] / (4 * np.pi)
        reference[k, m, : len(r)] = r
    away = float(np.linalg.norm(pruned - reference) / np.linalg.norm(reference))
    benchmark.extra_info |= {
        "first call, with compilation or its cache (s)": round(compile_s, 2),
        "ours (ms a position)": round(1e3 * ours_s / len(POSITIONS), 3),
        "pyroomacoustics (ms a position)": round(1e3 * theirs_s / len(POSITIONS), 2),
        "ratio": round(theirs_s / ours_s),
        "pruning error (dB)": round(float(error_db), 1),
        "away from pyroomacoustics": round(away, 5),
    }
    assert error_db <= -70.0
    assert away <= 3e-3
    assert theirs_s >= 50 * ours_s


@pytest.mark.parametrize("room", ["free field", "room"])
def test_eight_seconds_of_a_walking_source(benchmark, room):
    lattice = free_field() if room == "free field" else build_lattice([5.0, 4.0, 2.7], [0.8] * 6, prune_db=-60.0)
    signal = np.random.default_rng(1).normal(size=8 * 16000)
    path = Path(np.linspace([1.0, 1.0, 1.5], [4.0, 3.0, 1.5], 360), round(8 * 16000 / 359))
    benchmark.extra_info["images"] = lattice.images
    benchmark.pedantic(render_path, (lattice, signal, path, MICS, 16000.0, C), rounds=2, warmup_rounds=1)
