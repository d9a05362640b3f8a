"""OSPA beside Stone Soup's: time of a frame, and how far an assignment on d exceeds the least sum of d^p that defines the metric."""

from __future__ import annotations

from datetime import datetime

import numpy as np
import pytest
from bench_clock import in_turn

from sonobench_plugins.metric.ospa import ospa

FRAMES, CUT_M = 2000, 1.0
NOW = datetime(2026, 1, 1)


def sets(n, m):
    """Frames of n targets and m estimates in a room of 4 x 4 m, each estimate near a target but for one in five."""
    rng = np.random.default_rng(n)
    truth = rng.uniform(0, 4, (FRAMES, n, 2))
    found = truth[:, np.arange(m) % n] + rng.normal(0, 0.3, (FRAMES, m, 2))
    astray = rng.random((FRAMES, m)) < 0.2
    return truth, np.where(astray[..., None], rng.uniform(0, 4, (FRAMES, m, 2)), found)


@pytest.mark.parametrize("p", [1.0, 2.0])
@pytest.mark.parametrize(("n", "m"), [(3, 3), (3, 4), (8, 8)])
def test_ospa_of_a_frame_beside_stone_soup(benchmark, n, m, p):
    from stonesoup.metricgenerator.ospametric import OSPAMetric
    from stonesoup.types.state import State

    truth, found = sets(n, m)
    states = [[[State(r[:, None], timestamp=NOW) for r in frame] for frame in side] for side in (truth, found)]
    metric = OSPAMetric(c=CUT_M, p=p)

    def ours():
        return np.array([ospa(np.linalg.norm(x[:, None] - y, axis=-1), CUT_M, p)[0] for x, y in zip(truth, found, strict=True)])

    def theirs():
        return np.array([metric.compute_OSPA_distance(y, x).value for x, y in zip(*states, strict=True)])

    ours_s, theirs_s = in_turn(3, ours, theirs)
    benchmark.pedantic(ours, rounds=3)
    excess = theirs() - ours()
    benchmark.extra_info |= {
        "ours (us a frame)": 1e6 * ours_s / FRAMES,
        "Stone Soup (us a frame)": 1e6 * theirs_s / FRAMES,
        "times faster": theirs_s / ours_s,
        "frames where Stone Soup's exceeds the minimum (share)": float((excess > 1e-9).mean()),
        "largest excess (m)": float(excess.max()),
        "mean OSPA, ours (m)": float(ours().mean()),
        "mean OSPA, Stone Soup (m)": float(theirs().mean()),
    }
    assert excess.min() > -1e-9
    assert p > 1 or excess.max() < 1e-9
    assert theirs_s > ours_s
