"""Track before detect: the Bernoulli particle filter."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import pytest
from echo_scans import REACH_S, SPACE, TALKERS, setup
from echo_tables import RATE_HZ, field_scan

from sonobench.errors import InputError, SetupError
from sonobench.types import Detections, Scan, Setup
from sonobench_plugins.likelihood.tdoa_field import TdoaField
from sonobench_plugins.measurement.tdoa_images import TdoaImages
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.tbd import TrackBeforeDetect

WHERE = dataclasses.replace(setup(), period_s=0.1, rate_hz=RATE_HZ)
STILL = ConstantVelocity(velocity_walk_m_s=0.0)
FIELD = TdoaField(TdoaImages(reach_s=REACH_S, p_d=0.9, p_d_echo=0.6))


@dataclass(frozen=True)
class Hill:
    """A made-up likelihood: `gain` at (1, 2) m, falling off over .4 m, and `-loss` far away; scans of no field say nothing."""

    gains: tuple[float, ...]
    loss: float = 0.5

    def bind(self, space, setup):
        return self

    @property
    def sensors(self):
        return (0,)

    def log_ratio(self, x, scan):
        k = round(scan.time_s / 0.1) - 1
        if self.gains[k] == 0:
            return None
        near = np.exp(-0.5 * ((x[:, 0] - 1) ** 2 + (x[:, 2] - 2) ** 2) / 0.4**2)
        return (self.gains[k] + self.loss) * near - self.loss


def run(tracker, scans, seed=0, where=WHERE):
    rng = np.random.default_rng(seed)
    state, out = tracker.init(rng, where), []
    for scan in scans:
        state, estimate = tracker.step(rng, state, scan)
        out.append(estimate)
    return state, out


def empty_scans(k):
    return [Scan(0.1 * (i + 1), np.ones(1, bool)) for i in range(k)]


def on_a_grid(hill, k, p_b, p_s):
    """Existence and mean of a still target, by sums over cells of 2 cm."""
    c = (np.arange(150) + 0.5) * 0.02
    x = np.zeros((150 * 150, 4))
    x[:, 0], x[:, 2] = (a.ravel() for a in np.meshgrid(c, c, indexing="ij"))
    mass, out = np.zeros(len(x)), []
    for scan in empty_scans(k):
        ratio = hill.log_ratio(x, scan)
        if ratio is None:
            mass = p_s * mass
        else:
            prior = p_s * mass + p_b * (1 - mass.sum()) / len(x)
            post = prior * np.exp(ratio)
            mass = post / (1 - prior.sum() + post.sum())
        out.append((mass.sum(), mass @ x[:, [0, 2]] / mass.sum()))
    return out


def test_existence_and_place_are_those_of_sums_over_a_grid():
    gains = (1.0, 1.5, 0.5, 0.0, 2.0, 2.0, -1.0, -1.0, 0.0, 1.0)
    hill = Hill(gains)
    tracker = TrackBeforeDetect(
        STILL,
        hill,
        p_birth=0.1,
        p_s=0.95,
        particles=20000,
        born_particles=20000,
        born_speed_m_s=0.0,
        kernel=0.0,
        report_existence=0.0,
        cluster_m=9.0,
    )
    _, found = run(tracker, empty_scans(len(gains)))
    for estimate, (r, place) in zip(found, on_a_grid(hill, len(gains), 0.1, 0.95), strict=True):
        assert estimate.count == pytest.approx(r, abs=0.01)
        np.testing.assert_allclose(estimate.states[0, [0, 2]], place, atol=0.03)


def test_an_uninformative_field_leaves_existence_to_birth_and_death():
    tracker = TrackBeforeDetect(STILL, Hill((1e-9,) * 12, loss=0.0), p_birth=0.2, p_s=0.9, born_speed_m_s=0.0, kernel=0.0)
    _, found = run(tracker, empty_scans(12))
    r = 0.0
    for estimate in found:
        r = 0.9 * r + 0.2 * (1 - r)
        assert estimate.count == pytest.approx(r, rel=1e-6)


def test_silence_only_predicts():
    tracker = TrackBeforeDetect(STILL, Hill((3.0, 3.0, 0.0, 0.0)), born_speed_m_s=0.0, kernel=0.0)
    rng = np.random.default_rng(1)
    state = tracker.init(rng, WHERE)
    for scan in empty_scans(2):
        state, before = tracker.step(rng, state, scan)
    for k, time_s in enumerate((0.3, 0.4), 1):
        after, estimate = tracker.step(rng, state, Scan(time_s, np.zeros(1, bool)))
        assert estimate.count == pytest.approx(before.count * 0.99**k, rel=1e-9)
        np.testing.assert_array_equal(after.cloud.x, state.cloud.x)
        state = after
    state, nobody = run(tracker, [Scan(0.3, np.zeros(1, bool))])
    assert len(state.cloud.x) == 0
    assert nobody[0].count == 0


def test_probabilities_follow_the_time_that_passed():
    tracker = TrackBeforeDetect(STILL, Hill((3.0, 3.0)), kernel=0.0)
    rng = np.random.default_rng(1)
    state = tracker.init(rng, WHERE)
    for scan in empty_scans(2):
        state, before = tracker.step(rng, state, scan)
    _, later = tracker.step(rng, dataclasses.replace(state, likelihood=Hill((0.0,) * 9)), Scan(0.5, np.zeros(1, bool)))
    assert later.count == pytest.approx(before.count * 0.99**3, rel=0.05)  # some walk out of the room


def test_existence_rises_with_a_source_and_falls_when_it_ends():
    rng = np.random.default_rng(2)
    nobody = np.zeros((0, 4))
    shown = [nobody] * 8 + [TALKERS[:1]] * 12 + [nobody] * 8
    scans = [field_scan(0.1 * (k + 1), points, rng, height=0.15) for k, points in enumerate(shown)]
    _, found = run(TrackBeforeDetect(likelihood=FIELD), scans)
    r = np.array([e.count for e in found])
    assert r[:8].max() < 0.5
    assert r[12:20].min() > 0.9
    assert r[23:].max() < 0.5
    errors = [np.linalg.norm(e.states[0, [0, 2]] - TALKERS[0, [0, 2]]) for e in found[12:20]]
    assert max(errors) < 0.1
    assert all(len(e.states) == (e.count > 0.5) for e in found)


def test_weak_peaks_add_up_over_frames():
    """No scan has its five highest points at the five delays, yet the filter finds the source."""
    rng = np.random.default_rng(3)
    scans = [field_scan(0.1 * (k + 1), TALKERS[1:], rng, height=0.09) for k in range(25)]
    _, found = run(TrackBeforeDetect(likelihood=FIELD), scans)
    late = [e for e in found[15:] if len(e.states)]
    assert len(late) >= 7
    assert np.median([np.linalg.norm(e.states[0, [0, 2]] - TALKERS[1, [0, 2]]) for e in late]) < 0.15


def test_resampling_keeps_existence_and_the_expected_place():
    tracker = TrackBeforeDetect(STILL, Hill((1.0,)), kernel=0.0, particles=30000, born_particles=30000, report_existence=0.0, cluster_m=9.0)
    state, (estimate,) = run(tracker, empty_scans(1))
    w = np.exp(state.cloud.log_w)
    assert w.sum() == pytest.approx(estimate.count, rel=1e-9)
    np.testing.assert_allclose(w @ state.cloud.x / w.sum(), estimate.states[0], atol=0.02)
    assert len(w) == 30000


def test_nobody_is_outside_the_room():
    tracker = TrackBeforeDetect(ConstantVelocity(velocity_walk_m_s=3.0), Hill((2.0,) * 6))
    rng = np.random.default_rng(4)
    state = tracker.init(rng, WHERE)
    for scan in empty_scans(6):
        moved = tracker._moved(rng, state, 0.1)
        assert ((moved.x[:, [0, 2]] >= 0) & (moved.x[:, [0, 2]] <= 3)).all()
        state, estimate = tracker.step(rng, state, scan)
        assert 0 <= estimate.count <= 1


def test_nobody_is_ever_born_without_birth():
    _, found = run(TrackBeforeDetect(STILL, Hill((3.0, 3.0)), p_birth=0.0), empty_scans(2))
    assert [e.count for e in found] == [0.0, 0.0]


def test_what_does_not_fit_is_refused():
    free = Setup(**{f.name: getattr(WHERE, f.name) for f in dataclasses.fields(WHERE)} | {"box_m": None})
    with pytest.raises(SetupError, match="needs its box"):
        TrackBeforeDetect(likelihood=Hill((1.0,))).init(np.random.default_rng(0), free)
    with pytest.raises(InputError, match="gcc-peaks"):
        run(TrackBeforeDetect(likelihood=FIELD), [Scan(0.1, np.ones(1, bool), (Detections(np.zeros((1, 1)), np.zeros(1, int)),))])
    with pytest.raises(ValueError, match=r"p_birth 1\.5"):
        TrackBeforeDetect(p_birth=1.5)
    assert TrackBeforeDetect().space.names == SPACE.names
