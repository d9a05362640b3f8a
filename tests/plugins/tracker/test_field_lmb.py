"""The tracker on fields whose likelihood is known, and on the kit's spectra."""

import dataclasses

import numpy as np
import pytest

from sonobench.protocols import Mixture
from sonobench.testing import fixtures
from sonobench.types import Scan
from sonobench_plugins.birth.from_spectrum import FromSpectrum
from sonobench_plugins.likelihood.direction_spectrum import SpectrumLikelihood
from sonobench_plugins.motion.bearing_turn import BearingTurn
from sonobench_plugins.motion.bearing_velocity import BearingVelocity
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.imm import Imm
from sonobench_plugins.tracker.field_lmb import FieldLmb

ANGLES = [0, 2]
SETUP = fixtures.setup("directions")


@dataclasses.dataclass(frozen=True)
class Around:
    """Each scan's extra "z" names places; g is a Gaussian hump at each, over `floor`."""

    std: float = 0.3
    floor: float = 0.1
    sensors: tuple = (0,)

    def bind(self, space, setup):
        return self

    def log_ratio(self, x, scan):
        if "z" not in scan.extra:
            return None
        square = np.sum((np.asarray(x)[:, None, ::2] - scan.extra["z"]) ** 2, axis=-1)
        return np.log(self.floor + np.exp(-0.5 * square / self.std**2).sum(axis=1) / self.std**2)


@dataclasses.dataclass(frozen=True)
class Once:
    """The mixture at the start, and again before the scans of given times."""

    mixture: Mixture
    times: tuple = ()
    uses_scan: bool = False

    def start(self, space, setup, measurement):
        return None

    def initial(self, memory):
        return self.mixture

    def propose(self, rng, memory, scan, live):
        n = len(self.mixture.w) if scan.time_s in self.times else 0
        return memory, Mixture(*(a[:n] for a in self.mixture))


def places(*points, w=0.3, std=0.4):
    m = np.zeros((len(points), 4))
    m[:, ::2] = points
    return Mixture(np.full(len(points), w), m, np.tile(std**2 * np.eye(4), (len(points), 1, 1)), np.zeros(len(points), np.int64))


def scan(time_s, *z):
    return Scan(time_s, np.zeros(1, bool), extra={"z": np.array(z, float).reshape(-1, 2)})


def run(tracker, scans, setup=SETUP, seed=0):
    rng = np.random.default_rng(seed)
    state = tracker.init(rng, setup)
    found = []
    for one in scans:
        state, estimate = tracker.step(rng, state, one)
        found.append(estimate)
    return state, found


BUSY = [scan(0.1 * k, [1.0, 1.0], [2.0 + 0.05 * k, 0.5], *([[0.0, 2.0]] if k > 4 else [])) for k in range(1, 12)]
MANY = Once(places([1, 1], [2, 0.5], [0, 2], [3, 3], w=0.4), times=(0.4, 0.6))


@pytest.mark.parametrize("merge_distance", [0.0, 1.0])
@pytest.mark.parametrize("motion", [ConstantVelocity(), Imm(stay_s=0.3)], ids=["cv", "imm"])
def test_enumerated_sets_and_the_lmb_agree(motion, merge_distance):
    plain = FieldLmb(motion, Around(), MANY, particles=60, prune_existence=0.0, merge_distance=merge_distance, most_labels=14)
    for report in ("existence", "cardinality"):
        lmb, sets = (run(dataclasses.replace(plain, form=f, report=report), BUSY) for f in ("lmb", "enumerated"))
        assert len(lmb[0].tracks.r) >= 4
        for a, b in zip(lmb[1], sets[1], strict=True):
            np.testing.assert_array_equal(a.labels, b.labels)
            np.testing.assert_allclose(a.existence, b.existence, rtol=0, atol=1e-12)
            np.testing.assert_allclose(a.states, b.states, rtol=0, atol=1e-12)
            assert a.count == pytest.approx(b.count, abs=1e-12)
        np.testing.assert_allclose(lmb[0].tracks.r, sets[0].tracks.r, rtol=0, atol=1e-12)
    assert sets[0].sets.sum() == pytest.approx(1, abs=1e-12)


def test_sets_of_labels_that_are_dropped_at_birth_are_never_listed():
    """Twelve born beside twelve: all sets of 24 would be 128 MB a scan."""
    import tracemalloc

    crowd = Once(places(*[[k % 4, k // 4] for k in range(12)], w=0.3), times=(0.1, 0.2))
    plain = FieldLmb(ConstantVelocity(), Around(), crowd, particles=5, prune_existence=0.0, merge_distance=0.0, most_labels=12)
    (few, told), (_, known) = (run(dataclasses.replace(plain, form=f), BUSY[:1]) for f in ("enumerated", "lmb"))
    tracemalloc.start()
    run(dataclasses.replace(plain, form="enumerated"), BUSY[:2])
    assert tracemalloc.get_traced_memory()[1] < 10e6
    tracemalloc.stop()
    assert few.sets.shape == (2,) * 12
    for a, b in zip(told, known, strict=True):
        np.testing.assert_array_equal(a.labels, b.labels)
        assert a.count == pytest.approx(b.count, abs=1e-12)


def test_one_label_is_the_bernoulli_filter_of_quadrature():
    """One dimension that moves nowhere: existence and mean by sums over a fine grid."""
    still = ConstantVelocity(velocity_walk_m_s=0.0)
    start = places([0.8, 1.0], w=0.3)
    start.P[:, [1, 3], [1, 3]] = 0.0
    tracker = FieldLmb(still, Around(), Once(start), particles=60_000, p_s=0.95, resample_below=0.0, prune_existence=0.0)
    scans = [scan(0.1, [1.0, 1.0]), scan(0.2, [1.1, 0.9], [2.0, 2.0]), scan(0.3)]
    _, found = run(dataclasses.replace(tracker, extract_existence=0.0), scans)
    axis = np.linspace(-2, 4, 301)
    grid = np.zeros((301 * 301, 4))
    grid[:, 0], grid[:, 2] = (a.ravel() for a in np.meshgrid(axis, axis))
    p = np.exp(-0.5 * np.sum((grid[:, ::2] - [0.8, 1.0]) ** 2, axis=1) / 0.4**2)
    p, r = p / p.sum(), 0.3
    for one, estimate in zip(scans, found, strict=True):
        g = np.exp(Around().log_ratio(grid, one))
        eta = g @ p
        r = 0.95 * r
        r = r * eta / (1 - r + r * eta)
        p = p * g / eta
        assert estimate.existence[0] == pytest.approx(r, abs=0.01)
        np.testing.assert_allclose(estimate.states[0, ::2], p @ grid[:, ::2], atol=0.02)


def test_a_scan_without_a_field_is_no_miss_and_moves_on():
    tracker = FieldLmb(ConstantVelocity(), Around(), Once(places([1, 1], w=0.9)), p_s=0.9)
    silent = Scan(0.1, np.zeros(1, bool))
    _, (quiet,) = run(tracker, [silent])
    assert quiet.existence[0] == pytest.approx(0.9 * 0.9)
    _, (missed,) = run(tracker, [scan(0.1)])
    assert len(missed.states) == 0


def test_labels_on_one_peak_become_one_and_labels_are_never_used_again():
    twice = Once(places([1, 1], [1.05, 1.0], w=0.4), times=(0.5,))
    state, found = run(
        FieldLmb(ConstantVelocity(), Around(std=0.1), twice, merge_distance=2.0), [scan(0.1 * k, [1, 1]) for k in range(1, 9)]
    )
    assert [len(e.states) for e in found[1:]] == [1] * 7
    assert len({int(e.labels[0]) for e in found[1:]}) == 1
    assert state.following == 4
    _, both = run(FieldLmb(ConstantVelocity(), Around(std=0.1), twice, merge_distance=0.0), [scan(0.1, [1, 1])])
    assert len(both[0].states) == 2


def _directions(motion, k=12, birth=None):
    tracker = FieldLmb(motion, SpectrumLikelihood(), birth or FromSpectrum(gate_deg=10.0))
    scans = fixtures.scans(SETUP, fixtures.regular(k), clutter=0)
    return scans, run(tracker, [dataclasses.replace(s, detections=()) for s in scans])[1]


@pytest.mark.parametrize(
    "motion", [BearingVelocity(10.0), Imm((BearingVelocity(10.0), BearingTurn(60.0, 10.0)), stay_s=1.0)], ids=["cv", "imm"]
)
def test_two_talkers_of_a_spectrum_are_two_tracks(motion):
    _, found = _directions(motion)
    assert [len(e.states) for e in found[:3]] == [0, 0, 2]
    for estimate, time_s in zip(found[2:], fixtures.regular(12)[2:], strict=True):
        true = fixtures.measured_of(fixtures.talkers(np.array([time_s]))[0], SETUP.sensors[0], 343.0)
        assert estimate.labels.tolist() == [0, 1]
        order = np.argsort(estimate.states[:, 0])
        np.testing.assert_allclose(estimate.states[order][:, ANGLES], true[np.argsort(true[:, 0])], atol=0.04)


def test_births_are_where_peaks_persist_and_nobody_is():
    birth = FromSpectrum()
    scans = [dataclasses.replace(s, detections=()) for s in fixtures.scans(SETUP, fixtures.regular(3))]
    rng, space = np.random.default_rng(0), BearingVelocity().space
    memory = birth.start(space, SETUP, SpectrumLikelihood().bind(space, SETUP))
    nobody = Mixture(np.zeros(0), np.zeros((0, 4)), np.zeros((0, 4, 4)), np.zeros(0, np.int64))
    memory, first = birth.propose(rng, memory, scans[0], nobody)
    assert len(first.w) == 0
    after, both = birth.propose(rng, memory, scans[1], nobody)
    true = fixtures.measured_of(fixtures.talkers(np.array([0.2]))[0], SETUP.sensors[0], 343.0)
    np.testing.assert_allclose(both.m[np.argsort(both.m[:, 0])][:, ANGLES], true[np.argsort(true[:, 0])], atol=1e-3)
    assert both.w.max() == pytest.approx(0.3)
    known = Mixture(both.w[:1], both.m[:1], both.P[:1], both.mode[:1])
    _, other = birth.propose(rng, memory, scans[1], known)
    np.testing.assert_allclose(other.m, both.m[1:])
    elsewhere = fixtures.scan(SETUP, 0.3, np.array([[3.5, 0.4, 2.0]]), rng, 0)
    assert len(birth.propose(rng, after, elsewhere, nobody)[1].w) == 0
