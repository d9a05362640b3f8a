"""A step of the labelled filters of detections with five targets and ten false positions a scan, and a peer's association of as many tracks.

Stone Soup has no δ-GLMB filter. Its JPDA with efficient hypothesis management (EHM2) is the nearest: it associates tracks that are given, without
births, deaths and existence, so that it does less.
"""

from __future__ import annotations

import numpy as np
import pytest
from bench_clock import seconds

from sonobench.types import Detections, Scan, Sensor, Setup, Space
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.measurement.position import Position
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.delta_glmb import DeltaGlmb
from sonobench_plugins.tracker.gm_cbmember import GaussianCbMember
from sonobench_plugins.tracker.lmb import LabelledMultiBernoulli
from sonobench_plugins.transform.linearised import Linearised

STARTS = np.array([[-700.0, 14, -700, 14], [700, -14, -700, 14], [-700, 12, 700, -8], [0, 2, 800, -12], [600, -9, 0, 3]])
FRAMES = 50
BIRTH = Fixed(STARTS, np.array([[225.0, 25, 225, 25]]), np.full(1, 0.02))
TRACKERS = {
    "gibbs": DeltaGlmb,
    "murty": lambda *models, **more: DeltaGlmb(*models, truncation="murty", **more),
    "lmb": LabelledMultiBernoulli,
    "cbmember": GaussianCbMember,
}


def told() -> Setup:
    unit = Sensor("position", "plane", "position", np.zeros((1, 3)), Space.of("x_m", "y_m"))
    nominal = {"p_d": 0.95, "clutter_per_scan": 10.0, "position_std_m": 10.0}
    box = np.array([[-1000.0, -1000, 0], [1000, 1000, 1]])
    return Setup((unit,), ("plane",), np.eye(4)[None], period_s=1.0, box_m=box, nominal=nominal)


def scans() -> list[Scan]:
    rng = np.random.default_rng(0)
    out = []
    for k in range(1, FRAMES + 1):
        true = STARTS[:, [0, 2]] + k * STARTS[:, [1, 3]]
        seen = true[rng.random(5) < 0.95]
        z = np.concatenate([seen + 10 * rng.standard_normal(seen.shape), rng.uniform(-1000, 1000, (rng.poisson(10), 2))])
        out.append(Scan(float(k), [True], (Detections(rng.permutation(z), np.zeros(len(z), int)),)))
    return out


def run(tracker):
    rng = np.random.default_rng(0)
    state, found = tracker.init(rng, told()), []
    for scan in scans():
        state, estimate = tracker.step(rng, state, scan)
        found.append(estimate)
    return found


@pytest.mark.parametrize("name", TRACKERS)
def test_a_step_of_five_targets(benchmark, name):
    tracker = TRACKERS[name](ConstantVelocity(velocity_walk_m_s=1.0), Position(), Linearised(), BIRTH)
    run(tracker)
    found = benchmark.pedantic(run, (tracker,), rounds=3)
    benchmark.extra_info["ms a step"] = 1e3 * benchmark.stats.stats.min / FRAMES
    assert np.mean([len(e.states) for e in found[10:]]) == pytest.approx(5, abs=0.3)


def stone_soup():
    """Fifty steps of JPDA (EHM2) over five given tracks."""
    from datetime import datetime, timedelta

    from stonesoup.dataassociator.probability import JPDAwithEHM2
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.types.track import Track
    from stonesoup.types.update import GaussianStateUpdate
    from stonesoup.updater.kalman import KalmanUpdater

    start = datetime(2026, 1, 1)
    model = LinearGaussian(4, [0, 2], np.eye(2) * 100.0)
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([ConstantVelocity(1.0), ConstantVelocity(1.0)]))
    updater = KalmanUpdater(model)
    associator = JPDAwithEHM2(PDAHypothesiser(predictor, updater, clutter_spatial_density=10 / 4e6, prob_detect=0.95, prob_gate=0.9999))
    tracks = {Track([GaussianState(x[:, None], np.diag([225.0, 25, 225, 25]), start)]) for x in STARTS}
    for scan in scans():
        at = start + timedelta(seconds=scan.time_s)
        detections = {Detection(z[:, None], timestamp=at, measurement_model=model) for z in scan.detections[0].z}
        for track, hypotheses in associator.associate(tracks, detections, at).items():
            parts = [updater.update(h) if h else h.prediction for h in hypotheses]
            weights = np.array([float(h.probability) for h in hypotheses])
            means = np.column_stack([p.state_vector for p in parts])
            mean = means @ weights
            off = means - mean[:, None]
            cov = sum(w * np.asarray(p.covar) for w, p in zip(weights, parts, strict=True)) + (off * weights) @ off.T
            track.append(GaussianStateUpdate(mean[:, None], cov, hypotheses, timestamp=at))
    return tracks


def test_a_step_is_cheaper_than_the_peers_association(benchmark):
    tracker = DeltaGlmb(ConstantVelocity(velocity_walk_m_s=1.0), Position(), Linearised(), BIRTH)
    run(tracker)
    benchmark.pedantic(run, (tracker,), rounds=3)
    peer = min(seconds(stone_soup) for _ in range(2))
    ours = benchmark.stats.stats.min
    benchmark.extra_info.update({"ms a step": 1e3 * ours / FRAMES, "Stone Soup JPDA EHM2, ms a step": 1e3 * peer / FRAMES})
    assert ours < peer
