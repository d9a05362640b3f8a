import dataclasses
import pickle

import numpy as np
import phd_scenes as scenes
import pytest
from phd_linear import Position, scan, setup

from sonobench.errors import SetupError
from sonobench.protocols import Tracker
from sonobench.types import Detections, Scan, identical
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.birth.room import Room
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.tracker.smc_phd import ParticlePhd
from sonobench_plugins.transform.linearised import Linearised

BIRTHS = Fixed(scenes.BIRTHS, np.full((1, 4), 1e-4), np.array([0.1]), once=2)


def test_fits_the_role_and_pickles():
    assert isinstance(ParticlePhd(), Tracker)
    assert pickle.loads(pickle.dumps(ParticlePhd())) == ParticlePhd()


@pytest.mark.parametrize("sensors", [1, 2])
def test_converges_to_the_gaussian_mixture_where_that_is_exact(sensors):
    """Two targets, linear and Gaussian: 40 000 particles have its mass and mean, over one sensor and over two."""
    rng = np.random.default_rng(0)
    motion, model = ConstantVelocity(), Position(std=0.4, probability=0.8, clutter=2.0)
    births = Fixed([[2, 0.3, 2, 0], [6, 0, 7, -0.3]], [[0.3, 0.1, 0.3, 0.1]], [0.8, 0.7], once=2)
    exact = GaussianMixturePhd(motion, model, Linearised(), births, p_s=0.95, prune_weight=0.0, merge_distance=0.0, max_components=10**5)
    drawn = ParticlePhd(motion, model, births, p_s=0.95, particles=40_000, most_particles=80_000, born_particles=20_000, cluster_m=2.0)
    where = setup(sensors)
    a, b = exact.init(rng, where), drawn.init(rng, where)
    for k in range(1, 3):
        z = np.array([[2 + 0.3 * k, 2], [6, 7 - 0.3 * k]]) + 0.4 * rng.standard_normal((2, 2))
        rows = np.r_[z, rng.uniform(0, 10, (2, 2))]
        frame = Scan(float(k), [True] * sensors, (Detections(np.tile(rows, (sensors, 1)), np.repeat(np.arange(sensors), 4)),))
        a, of_a = exact.step(rng, a, frame)
        b, of_b = drawn.step(rng, b, frame)
        assert of_b.count == pytest.approx(of_a.count, rel=0.03)
        w = np.exp(b.cloud.log_w)
        np.testing.assert_allclose(w @ b.cloud.x / w.sum(), a.mixture.w @ a.mixture.m / a.mixture.w.sum(), atol=0.05)


def test_mass_is_kept_by_resampling_and_decays_in_silence():
    rng = np.random.default_rng(1)
    births = Fixed([[2, 0, 2, 0.0]], [[0.3, 0.1, 0.3, 0.1]], [1.0], once=1)
    tracker = ParticlePhd(ConstantVelocity(), Position(probability=0.5, clutter=1.0), births, p_s=0.8)
    state, estimate = tracker.step(rng, tracker.init(rng, setup()), scan(1.0, [[2, 2]]))
    assert np.exp(state.cloud.log_w).sum() == pytest.approx(estimate.count)
    quiet, after = tracker.step(rng, state, scan(1.5, [[2, 2]], searched=[False]))
    assert after.count == pytest.approx(estimate.count * 0.8**0.5)
    assert len(quiet.cloud.x) == len(state.cloud.x)
    missed, _ = tracker.step(rng, state, scan(1.5, []))
    assert np.exp(missed.cloud.log_w).sum() == pytest.approx(estimate.count * 0.8**0.5 * 0.5)


@pytest.mark.parametrize(
    "values",
    [
        {"birth": BIRTHS},
        {"birth": FromDetections()},
        {"birth": BIRTHS, "extraction": "measurement"},
        {"birth": BIRTHS, "extraction": "labels"},
    ],
    ids=str,
)
def test_three_talkers_are_tracked_through_seven_false_rows_a_scan(values):
    estimates = scenes.run(ParticlePhd(**values), scenes.setup(), scenes.scans(np.random.default_rng(2)))
    assert scenes.mean_ospa(estimates) < 0.4


def test_extraction_changes_what_is_reported_and_nothing_else():
    """Section 5.2.2 of Liang 2016: weights and particles do not know of labels."""
    frames = scenes.scans(np.random.default_rng(5))[:12]
    counts = {
        e: [r.count for r in scenes.run(ParticlePhd(birth=BIRTHS, extraction=e), scenes.setup(), frames)] for e in ("balls", "labels")
    }
    assert counts["balls"] == counts["labels"]


def test_a_talker_keeps_its_label_and_no_label_comes_twice():
    estimates = scenes.run(ParticlePhd(birth=BIRTHS, extraction="labels"), scenes.setup(), scenes.scans(np.random.default_rng(2)))
    last: dict[int, int] = {}
    for k, e in enumerate(estimates):
        assert len(set(e.labels)) == len(e.labels)
        for label in e.labels:
            assert k - last.get(int(label), k) < 30  # who was gone for long comes back as another
            last[int(label)] = k
    seen = np.concatenate([e.labels for e in estimates])
    names, times = np.unique(seen, return_counts=True)
    assert np.sort(times)[-3:].sum() > 0.7 * len(seen)  # paths cross, and Langevin velocities tell little
    assert len(names) < 12


def test_same_seed_same_bits_whatever_the_order_of_rows():
    frames = scenes.scans(np.random.default_rng(3))[:10]
    turned = [
        dataclasses.replace(f, detections=tuple(dataclasses.replace(d, z=d.z[::-1], sensor=d.sensor[::-1]) for d in f.detections))
        for f in frames
    ]
    a, b, c = (scenes.run(ParticlePhd(birth=BIRTHS), scenes.setup(), f, seed) for f, seed in ((frames, 0), (turned, 0), (frames, 1)))
    assert all(identical(x, y) for x, y in zip(a, b, strict=True))
    assert not all(identical(x, y) for x, y in zip(a, c, strict=True))


@pytest.mark.parametrize("extraction", ["balls", "measurement", "k-means", "labels"])
def test_neither_state_nor_scan_is_changed(extraction):
    tracker, rng = ParticlePhd(birth=BIRTHS, extraction=extraction), np.random.default_rng(0)
    state = tracker.init(rng, scenes.setup())
    for frame in scenes.scans(np.random.default_rng(4))[:5]:
        for array in state.cloud:
            if array is not None:
                array.flags.writeable = False
        before = pickle.dumps((state, frame))
        after, _ = tracker.step(rng, state, frame)
        assert pickle.dumps((state, frame)) == before
        state = after


def test_no_survivors_and_no_births_is_nobody():
    rng = np.random.default_rng(0)
    tracker = ParticlePhd(p_s=0.0)
    state = tracker.init(rng, scenes.setup())
    for k in range(1, 4):
        state, estimate = tracker.step(rng, state, Scan(0.032 * k, [True]))
    assert estimate.states.shape == (0, 4)
    assert estimate.count == 0


def test_certain_detection_and_no_rows_leaves_nobody():
    rng = np.random.default_rng(0)
    tracker = ParticlePhd(ConstantVelocity(), Position(probability=1.0, clutter=1.0), Fixed([[2, 0, 2, 0.0]], [[0.1] * 4], [1.0], once=1))
    state, estimate = tracker.step(rng, tracker.init(rng, setup()), scan(1.0, []))
    assert estimate.count == 0
    state, estimate = tracker.step(rng, state, scan(2.0, [[1, 1]]))
    assert len(estimate.states) == 0


@pytest.mark.parametrize(
    ("tracker", "where", "says"),
    [
        (ParticlePhd(extraction="measurement"), scenes.setup(False), 'use extraction = "balls"'),
        (ParticlePhd(update="stacked"), scenes.setup(False), "smc-phd with update"),
        (ParticlePhd(measurement=Position(modes=3), extraction="measurement"), setup(), "predicts up to 3"),
        (ParticlePhd(measurement=Tdoa(), birth=Room()), scenes.setup(box_m=None), "needs the room's box"),
    ],
)
def test_what_does_not_fit_is_refused_at_init_by_name(tracker, where, says):
    with pytest.raises(SetupError, match=says):
        tracker.init(np.random.default_rng(0), where)


@pytest.mark.parametrize(
    "values", [{"p_s": -0.1}, {"extraction": "clusters"}, {"resampling": "multinomial"}, {"particles": 0}, {"extract_weight": 0.0}]
)
def test_impossible_parameters_are_refused(values):
    with pytest.raises(ValueError):
        ParticlePhd(**values)


def test_a_joint_update_says_which_cut_it_used_and_how_many_rows_it_left_out():
    where, rng = scenes.setup(False, clutter=2.0), np.random.default_rng(0)
    tracker = ParticlePhd(update="joint", birth=BIRTHS)
    _, estimate = tracker.step(rng, tracker.init(rng, where), scenes.scans(rng, False, clutter=2.0)[0])
    assert (estimate.info["cut"], estimate.info["left_out"]) == (1e-6, 0)
