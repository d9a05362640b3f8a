"""One scan of the tracker of fields: five sources, four motion models, births looked for."""

import dataclasses

import numpy as np

from sonobench.components import build
from sonobench.registry import Registry
from sonobench.signal.cumulants import LIVE
from sonobench.signal.subspace import Subspace, spectrum, steering
from sonobench.testing import fixtures
from sonobench.types import Scan


def test_a_scan_of_five_sources(benchmark):
    registry = Registry.load()
    tracker = build("pipeline", {"use": "zhang-cum-amms-glmb"}, registry).tracker
    rng = np.random.default_rng(0)
    u = np.linalg.svd(rng.standard_normal((3, 3)))[0]
    sources = np.linalg.qr(steering(np.concatenate([u, -u[:2]]), 10).T)[0]
    one = Subspace(LIVE @ LIVE.T - sources @ sources.T, np.zeros((10, 10)), 5, np.zeros(9))
    scans = [Scan(float(k), np.zeros(1, bool), (), {"spectrum": spectrum(one, 0.03)}) for k in range(1, 7)]
    state = tracker.init(rng, dataclasses.replace(fixtures.setup("directions"), period_s=1.0))
    for scan in scans[:-1]:
        state, estimate = tracker.step(rng, state, scan)
    assert len(estimate.states) == 5
    benchmark(tracker.step, rng, state, scans[-1])
