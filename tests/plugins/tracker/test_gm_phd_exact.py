"""The whole recursion of the Gaussian-mixture PHD filter against plain loops, and what its numbers must not depend on."""

from __future__ import annotations

import dataclasses

import numpy as np
import phd_scenes as scenes
import pytest
from gm_phd_by_hand import step
from phd_linear import Position, scan, setup

from sonobench.components import build
from sonobench.errors import SetupError
from sonobench.protocols import Mixture
from sonobench.registry import Registry
from sonobench.types import Detections, Scan
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.measurement.tdoa import BoundTdoa, Tdoa
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.spawn.offset import Offset
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.transform.cubature import Cubature
from sonobench_plugins.transform.linearised import Linearised

BIRTHS = Fixed(scenes.BIRTHS, np.array([[4e-2, 1e-2, 4e-2, 1e-2]]), np.array([0.1]), once=2)
SPAWN = Offset(weights=[0.05, 0.02], offsets=[[0.1, 0, 0, 0], [0, 0, -0.2, 0.3]], variances=[[1e-2, 1e-2, 1e-2, 1e-2]])


@pytest.mark.parametrize("intensity", ["density", "count"])
@pytest.mark.parametrize("noise", ["exact", "diagonal"])
@pytest.mark.parametrize("spawn", [None, SPAWN], ids=["no spawn", "spawn"])
def test_ten_scans_of_the_paper_are_the_plain_loops_component_by_component(intensity, noise, spawn):
    where = scenes.setup(sigma_s=3e-4)
    motion = Langevin(noise=noise)
    tracker = GaussianMixturePhd(
        motion, Tdoa(clutter_intensity=intensity), birth=BIRTHS, spawn=spawn, max_components=30, prune_weight=1e-4, merge_distance=1.0
    )
    F, Q = motion.matrices(scenes.PERIOD_S)
    volume = 1.0 if intensity == "count" else (2 * 0.6 / 343) ** 4
    model = {
        "F": F,
        "Q": Q,
        "h": lambda x: scenes.delays(x[None])[0],
        "R": np.eye(4) * 9e-8,
        "p_s": 0.99,
        "p_d": 0.98,
        "kappa": lambda z: 7.0 / volume,
        "born": [(0.1, scenes.BIRTHS[2], np.diag(BIRTHS.variances[2]))],
        "spawned": []
        if spawn is None
        else [(w, o, np.diag(v)) for w, o, v in zip(spawn.weights, spawn.offsets, spawn.variances, strict=True)],
        "prune": 1e-4,
        "merge": 1.0,
        "most": 30,
    }
    parts = [(0.1, m, np.diag(BIRTHS.variances[0])) for m in scenes.BIRTHS[:2]]
    rng = np.random.default_rng(3)
    state = tracker.init(rng, where)
    for frame in scenes.scans(rng, sigma_s=3e-4)[:10]:
        state, _ = tracker.step(rng, state, frame)
        z = frame.detections[0].z
        parts = step(parts, z[np.lexsort(z.T)], model)
        order = np.argsort(-state.mixture.w, kind="stable")
        assert len(order) == len(parts)
        np.testing.assert_allclose(state.mixture.w[order], [w for w, _, _ in parts], rtol=1e-7)
        np.testing.assert_allclose(state.mixture.m[order], [m for _, m, _ in parts], rtol=0, atol=1e-7)
        np.testing.assert_allclose(state.mixture.P[order], [P for _, _, P in parts], rtol=0, atol=1e-8)


def test_the_presets_differ_in_their_transform_alone_and_uk_is_ck():
    registry = Registry.load([])
    trackers = {name: build("tracker", name, registry) for name in ("ek-phd", "uk-phd", "ck-phd")}
    assert all(dataclasses.replace(t, transform=Cubature()) == trackers["ck-phd"] for t in trackers.values())
    where, rng = scenes.setup(), np.random.default_rng(1)
    frames = scenes.scans(rng)[:30]
    found = {}
    for name in ("uk-phd", "ck-phd"):
        tracker = dataclasses.replace(trackers[name], birth=BIRTHS)
        state = tracker.init(rng, where)
        for frame in frames:
            state, _ = tracker.step(rng, state, frame)
        found[name] = state.mixture
    for a, b in zip(found["uk-phd"], found["ck-phd"], strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-13)


@dataclasses.dataclass(frozen=True)
class InMetres:
    """`Tdoa` with every number in metres: delays times c, clutter per m⁴."""

    of: Tdoa

    def bind(self, space, where):
        return BoundInMetres(self.of.bind(space, where))


@dataclasses.dataclass(frozen=True)
class BoundInMetres:
    of: BoundTdoa
    n_modes = 1

    @property
    def sensors(self):
        return self.of.sensors

    def h(self, x, q, pose=None):
        return 343.0 * self.of.h(x, q, pose)

    def jacobian(self, x, q, pose=None):
        return 343.0 * self.of.jacobian(x, q, pose)

    def residual(self, z, z_hat, q):
        return z - z_hat

    def R(self, q, scan=None):
        return 343.0**2 * self.of.R(q)

    def p_d(self, x, q, scan=None):
        return self.of.p_d(x, q)

    def log_clutter(self, z, q, valid=None):
        return self.of.log_clutter(z / 343.0, q) - (4 * np.log(343.0) if self.of.is_density else 0.0)


def weights_in(unit_m, tdoa, transform=None):
    """Weights and means of 20 scans, in seconds, or in metres."""
    where, rng = scenes.setup(), np.random.default_rng(2)
    tracker = GaussianMixturePhd(measurement=InMetres(tdoa) if unit_m else tdoa, birth=BIRTHS, transform=transform or Cubature())
    state, found = tracker.init(rng, where), []
    for frame in scenes.scans(rng)[:20]:
        rows = Detections((343.0 if unit_m else 1.0) * frame.detections[0].z, frame.detections[0].sensor)
        state, _ = tracker.step(rng, state, Scan(frame.time_s, frame.searched, (rows,)))
        found.append(state.mixture)
    return found


@pytest.mark.parametrize("transform", [Linearised(), Cubature()], ids=lambda t: type(t).__name__)
def test_seconds_and_metres_agree_when_the_clutter_is_a_density(transform):
    for a, b in zip(weights_in(False, Tdoa(), transform), weights_in(True, Tdoa(), transform), strict=True):
        np.testing.assert_allclose(b.w, a.w, rtol=1e-8)
        np.testing.assert_allclose(b.m, a.m, rtol=0, atol=1e-9)


def test_the_literal_count_gives_another_result_in_another_unit():
    literal = Tdoa(clutter_intensity="count")
    a, b = weights_in(False, literal)[-1], weights_in(True, literal)[-1]
    assert abs(a.w.sum() - b.w.sum()) > 0.05


def test_the_iterated_corrector_depends_on_the_order_of_its_sensors():
    rng = np.random.default_rng(4)
    births = Fixed([[1, 0, 1, 0], [2, 0, 3, 0.0]], [[1.0] * 4], [0.5])
    tracker = GaussianMixturePhd(
        ConstantVelocity(), Position(std=0.3, clutter=1.0), Linearised(), births, prune_weight=0.0, merge_distance=0.0
    )
    z, y = rng.uniform(0, 4, (3, 2)), np.zeros((0, 2))
    counts = []
    for first, second in ((z, y), (y, z)):
        both = Scan(1.0, [True, True], (Detections(np.r_[first, second], [0] * len(first) + [1] * len(second)),))
        counts.append(tracker.step(rng, tracker.init(rng, setup(2)), both)[1].count)
    assert abs(counts[0] - counts[1]) > 0.1


def test_spawned_components_have_the_products_of_weights_and_the_sums_of_covariances():
    m, P = np.array([[1.0, 0, 2, 0], [3, 1, 0, 0]]), np.stack([np.eye(4), 2 * np.eye(4)])
    found = SPAWN.spawned(Mixture(np.array([0.5, 2.0]), m, P, np.array([0, 1])))
    np.testing.assert_allclose(found.w, [0.025, 0.1, 0.01, 0.04])
    np.testing.assert_allclose(found.m[3], [3, 1, -0.2, 0.3])
    np.testing.assert_allclose(found.P[3], 2 * np.eye(4) + 1e-2 * np.eye(4))
    np.testing.assert_array_equal(found.mode, [0, 1, 0, 1])


def test_a_frame_that_nobody_searched_spawns_nothing():
    rng = np.random.default_rng(0)
    births = Fixed([[1, 0, 1, 0.0]], [[0.1] * 4], [1.0], once=1)
    tracker = GaussianMixturePhd(ConstantVelocity(), Position(), Linearised(), births, SPAWN, p_s=1.0)
    state = tracker.init(rng, setup())
    quiet, _ = tracker.step(rng, state, scan(1.0, [], searched=[False]))
    assert quiet.mixture.w.sum() == pytest.approx(1.0)


def test_offsets_that_do_not_fit_are_refused():
    with pytest.raises(SetupError, match="offsets of 4 numbers; the state has 6"):
        GaussianMixturePhd(ConstantVelocity(dims=3), spawn=SPAWN).init(np.random.default_rng(0), scenes.setup())
    with pytest.raises(ValueError, match="3 rows of variances for 2 offsets"):
        Offset([0.1, 0.1], np.zeros((2, 4)), np.zeros((3, 4)))
    with pytest.raises(ValueError, match="must not be negative"):
        Offset([-0.1], np.zeros((1, 4)), np.zeros((1, 4)))
