"""The exact update for several detections a target: time by rows and particles, beside listing all partitions, and for four pairs jointly."""

from __future__ import annotations

import numpy as np
import pytest
from bench_clock import in_turn, seconds
from echo_scans import SPACE, cloud, five_modes, scan_of, setup
from filtering_partitions import listed

from sonobench.filtering.multidetection import evidence, factors
from sonobench_plugins.measurement.tdoa import Tdoa


@pytest.mark.parametrize("std_s", [2e-5, 5e-5, 1e-4])
@pytest.mark.parametrize(("rows", "particles"), [(6, 1000), (10, 2000), (14, 2000)])
def test_an_update_of_one_pair_with_five_modes(benchmark, rows, particles, std_s):
    where = setup(std_s=std_s)
    model = five_modes(where)
    log_w, x = cloud(particles)
    scan = scan_of(model, where, rows)
    seen = evidence(x, scan, model, where, (0,))

    def update():
        return factors(log_w, *seen)

    def whole():
        return factors(log_w, *evidence(x, scan, model, where, (0,)))

    update_s, whole_s = in_turn(15, update, whole)
    found, exact = update(), factors(log_w, *seen, cut=0.0) if rows <= 10 else None
    benchmark.pedantic(update, rounds=5)
    w = np.exp(log_w)
    benchmark.extra_info |= {
        "update (ms)": 1e3 * update_s,
        "with the evidence (ms)": 1e3 * whole_s,
        "sets": found.sets,
        "mass after": float(w @ found.factor),
        "mass that the cut moves": None if exact is None else float(w @ np.abs(found.factor - exact.factor)),
    }
    assert exact is None or w @ np.abs(found.factor - exact.factor) < 1e-4


def test_beside_listing_all_partitions_in_numpy(benchmark):
    """Six rows, 1000 particles: 203 partitions, every L_W computed for each."""
    where = setup()
    model = five_modes(where)
    log_w, x = cloud(1000)
    log_pg, log_miss, log_kappa = evidence(x, scan_of(model, where, 6), model, where, (0,))
    args = np.exp(log_w), np.exp(log_pg), np.exp(log_miss), np.exp(log_kappa)
    slow_s = seconds(lambda: listed(*args))
    (ours_s,) = in_turn(15, lambda: factors(log_w, log_pg, log_miss, log_kappa))
    benchmark.pedantic(lambda: factors(log_w, log_pg, log_miss, log_kappa), rounds=5)
    found = factors(log_w, log_pg, log_miss, log_kappa, cut=0.0).factor
    benchmark.extra_info |= {"ours (ms)": 1e3 * ours_s, "listed (s)": slow_s, "times faster": slow_s / ours_s}
    np.testing.assert_allclose(found, listed(*args), rtol=1e-10)
    assert slow_s > 100 * ours_s


@pytest.mark.parametrize("rows", [3, 4, 6])
def test_four_pairs_jointly(benchmark, rows):
    """4 pairs of `rows` rows each, direct delays only: time, and what a coarser cut costs."""
    where = setup(pairs=4, clutter=1.5)
    model = Tdoa(p_d=0.75).bind(SPACE, where)
    log_w, x = cloud(2000)
    echoes = five_modes(where)
    seen = evidence(x, scan_of(echoes, where, rows), model, where, (0, 1, 2, 3))
    cuts = (1e-6, 1e-4, 1e-3)
    taken = in_turn(7, *[lambda cut=cut: factors(log_w, *seen, cut=cut) for cut in cuts])
    found = [factors(log_w, *seen, cut=cut) for cut in cuts]
    benchmark.pedantic(lambda: factors(log_w, *seen), rounds=5)
    w = np.exp(log_w)
    for cut, one, one_s in zip(cuts, found, taken, strict=True):
        moved = float(w @ np.abs(one.factor - found[0].factor))
        benchmark.extra_info[f"cut {cut:g} (used {one.cut:g})"] = {"ms": 1e3 * one_s, "sets": one.sets, "mass moved": moved}
        assert moved < 100 * cut
