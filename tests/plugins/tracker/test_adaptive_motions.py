"""Motions that learn from updates: who carries what they learn, and who refuses them."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from sonobench.errors import SetupError
from sonobench.protocols import Tracker
from sonobench.testing import fixtures
from sonobench.types import Detections, Scan, Sensor, Setup, Space
from sonobench_plugins.birth.given import Given
from sonobench_plugins.measurement.position import Position
from sonobench_plugins.motion.adaptive_constant_velocity import AdaptiveConstantVelocity
from sonobench_plugins.motion.random_walk import RandomWalk
from sonobench_plugins.tracker.cbmember import CbMember
from sonobench_plugins.tracker.delta_glmb import DeltaGlmb
from sonobench_plugins.tracker.field_lmb import FieldLmb
from sonobench_plugins.tracker.gaussian_filter import GaussianFilter
from sonobench_plugins.tracker.gm_cbmember import GaussianCbMember
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.tracker.lmb import LabelledMultiBernoulli
from sonobench_plugins.tracker.smc_phd import ParticlePhd
from sonobench_plugins.tracker.tbd import TrackBeforeDetect

MOTION = AdaptiveConstantVelocity(limits_m_s=(0.1, 3.0), memory_s=0.2)
START = Given("starts", once=1, position_std_m=0.5, velocity_std_m_s=1.0)


@pytest.mark.parametrize(
    "tracker",
    [CbMember, DeltaGlmb, FieldLmb, GaussianCbMember, GaussianMixturePhd, LabelledMultiBernoulli, ParticlePhd, TrackBeforeDetect],
    ids=lambda t: t.__name__,
)
@pytest.mark.parametrize("motion", [MOTION, RandomWalk(adaptive=True)], ids=["velocity", "walk"])
def test_a_tracker_that_would_never_adapt_refuses(tracker: type[Tracker], motion: AdaptiveConstantVelocity | RandomWalk) -> None:
    with pytest.raises(SetupError, match=f"{type(motion).__name__} learns from updates, so that it would never adapt"):
        tracker(motion=motion).init(np.random.default_rng(0), fixtures.setup())  # type: ignore[call-arg]


def _setup() -> Setup:
    sensor = Sensor("position", "room", "position", np.zeros((0, 3)), Space.of("x_m", "y_m"))
    given = {"starts": np.array([[0.0, 1.0, 2.0, 0.0, 0.5, 0.0, 0.0]])}
    return Setup((sensor,), ("room",), np.eye(4)[None], box_m=np.array([[-9.0] * 3, [9.0] * 3]), given=given)


def _scans() -> list[Scan]:
    """Two seconds of positions, some scans without any; the target turns off halfway."""
    rng, scans = np.random.default_rng(1), []
    for k in range(1, 21):
        at = np.array([1.0 + 0.05 * k, 2.0 + (0.1 * (k - 10) if k > 10 else 0.0)]) + 0.02 * rng.standard_normal(2)
        rows = (Detections(at[None], np.zeros(1, int)),) if k % 4 else ()
        scans.append(Scan(0.1 * k, np.ones(1, bool), rows))
    return scans


def test_the_gaussian_filter_is_the_kalman_filter_whose_noise_adapts() -> None:
    tracker = GaussianFilter(MOTION, Position(position_std_m=0.1, p_d=1.0, clutter_per_scan=0.0), birth=START)
    rng = np.random.default_rng(0)
    state = tracker.init(rng, _setup())
    H, m, P = np.eye(4)[::2], np.array([1.0, 0.5, 2.0, 0.0]), np.diag([0.25, 1.0] * 2)
    memory, heard_s, time_s, used = None, 0.0, 0.0, []
    for scan in _scans():
        state, estimate = tracker.step(rng, state, scan)
        F, Q = MOTION.matrices(scan.time_s - time_s, memory)
        time_s, m, P = scan.time_s, F @ m, F @ P @ F.T + Q
        if scan.detections:
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + 0.01 * np.eye(2))
            after = m + K @ (scan.detections[0].z[0] - H @ m)
            memory, heard_s = MOTION.adapt(memory, m, after, time_s - heard_s), time_s
            m, P = after, P - K @ H @ P
            used.append(memory)
        assert_allclose(estimate.states[0], m, atol=1e-9)
    assert np.shape(state.motion) == (2,)
    assert max(q[1] for q in used[8:]) > 2 * used[7][1]  # along y, along which it turned


def test_several_process_noises_share_what_the_motion_learns() -> None:
    tracker = GaussianFilter(MOTION, Position(position_std_m=0.1, p_d=1.0, clutter_per_scan=0.0), birth=START, process_scales=(1.0, 4.0))
    rng = np.random.default_rng(0)
    state = tracker.init(rng, _setup())
    for scan in _scans():
        state, _ = tracker.step(rng, state, scan)
    assert np.shape(state.motion) == (2,)
