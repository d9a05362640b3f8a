import dataclasses
import pickle
from datetime import datetime

import numpy as np
import phd_scenes as scenes
import pytest
from phd_linear import Position, frozen, scan, setup
from scipy.stats import multivariate_normal

from sonobench.errors import InputError, SetupError
from sonobench.protocols import Tracker
from sonobench.types import Detections, Scan, Space, identical
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.birth.room import Room
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.transform.cubature import Cubature
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

TRANSFORMS = [Linearised(), Unscented(alpha=0.5, beta=2.0, kappa=-1.0), Cubature()]
EXACT = {"prune_weight": 0.0, "merge_distance": 0.0, "max_components": 10**6}


def one(x, P=None, w=1.0, once=1):
    """One component, at the start only."""
    return Fixed(np.array([x], float), np.array([np.full(4, 0.2) if P is None else P]), np.array([w]), once=once)


def chen_births():
    return Fixed(scenes.BIRTHS, np.full((1, 4), 1e-4), np.array([0.1]), once=2)


def test_fits_the_role_pickles_prints_and_compares():
    tracker = GaussianMixturePhd()
    assert isinstance(tracker, Tracker)
    assert pickle.loads(pickle.dumps(tracker)) == tracker
    assert "Langevin" in repr(tracker)
    state = tracker.init(np.random.default_rng(0), scenes.setup())
    assert identical(pickle.loads(pickle.dumps(state)).mixture, state.mixture)


def test_one_target_always_detected_without_clutter_is_the_kalman_filter():
    rng = np.random.default_rng(0)
    motion, model = ConstantVelocity(), Position(probability=1.0, clutter=0.0)
    tracker = GaussianMixturePhd(motion, model, Linearised(), one([1, 0.5, 2, -0.3]), p_s=1.0)
    state = tracker.init(rng, setup())
    m, P = np.array([1, 0.5, 2, -0.3]), np.eye(4) * 0.2
    H, R, time_s = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]]), np.eye(2) * 0.01, 0.0
    for dt_s in (0.5, 0.1, 0.0, 1.7, 0.03):
        time_s += dt_s
        F, Q = motion.matrices(dt_s)
        m, P = F @ m, F @ P @ F.T + Q
        z = H @ m + 0.1 * rng.standard_normal(2)
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        m, P = m + K @ (z - H @ m), P - K @ S @ K.T
        state, estimate = tracker.step(rng, state, scan(time_s, [z]))
        np.testing.assert_allclose(estimate.states, [m], rtol=0, atol=1e-12)
        np.testing.assert_allclose(estimate.covs, [P], rtol=0, atol=1e-12)
        np.testing.assert_allclose(estimate.existence, [1], atol=1e-12)
        assert estimate.count == pytest.approx(1, abs=1e-12)


def literal_filter(transform, m, P, z, h, R):
    """EKF (complex-step Jacobian) or sigma-point update of one Gaussian, written from the textbook with loops."""
    if isinstance(transform, Linearised):
        H = np.array([np.imag(h(m + 1e-30j * e)) / 1e-30 for e in np.eye(4)]).T
        z_hat, S, C = np.real(h(m + 0j)), H @ P @ H.T + R, P @ H.T
    else:
        a, b, kappa = (1.0, 0.0, 0.0) if isinstance(transform, Cubature) else (transform.alpha, transform.beta, transform.kappa)
        lam = a * a * (4 + kappa) - 4
        L = np.linalg.cholesky(P) * np.sqrt(4 + lam)
        points = [m] + [m + L[:, i] for i in range(4)] + [m - L[:, i] for i in range(4)]
        wm = np.array([lam / (4 + lam)] + [0.5 / (4 + lam)] * 8)
        wc = wm.copy()
        wc[0] += 1 - a * a + b
        images = np.array([np.real(h(p + 0j)) for p in points])
        z_hat = wm @ images
        S = sum(w * np.outer(i - z_hat, i - z_hat) for w, i in zip(wc, images, strict=True)) + R
        C = sum(w * np.outer(p - m, i - z_hat) for w, p, i in zip(wc, points, images, strict=True))
    K = C @ np.linalg.inv(S)
    return m + K @ (z - z_hat), P - K @ S @ K.T


def delays(x):
    p = x[[0, 2]]
    r = np.sqrt(((p - scenes.MICROPHONES) ** 2).sum(axis=1))
    return (r[::2] - r[1::2]) / 343.0


def stone_soup_update(transform, m, P, z, R):
    from stonesoup.models.measurement.nonlinear import NonLinearGaussianMeasurement
    from stonesoup.types.array import CovarianceMatrix, StateVector
    from stonesoup.types.detection import Detection
    from stonesoup.types.hypothesis import SingleHypothesis
    from stonesoup.types.prediction import GaussianStatePrediction
    from stonesoup.updater.kalman import CubatureKalmanUpdater, ExtendedKalmanUpdater, UnscentedKalmanUpdater

    class Delays(NonLinearGaussianMeasurement):
        ndim_meas = 4

        def function(self, state, noise=False, **kwargs):
            columns = np.asarray(state.state_vector, float)
            return type(state.state_vector)(np.array([delays(c) for c in columns.T]).T)

        def jacobian(self, state, **kwargs):
            x = np.asarray(state.state_vector, float)[:, 0]
            return np.array([np.imag(delays(x + 1e-30j * e)) / 1e-30 for e in np.eye(4)]).T

        def rvs(self, *args, **kwargs):
            raise NotImplementedError

        def pdf(self, *args, **kwargs):
            raise NotImplementedError

    model = Delays(ndim_state=4, mapping=(0, 2), noise_covar=CovarianceMatrix(R))
    if isinstance(transform, Linearised):
        updater = ExtendedKalmanUpdater(model)
    elif isinstance(transform, Cubature):
        updater = CubatureKalmanUpdater(model)
    else:
        updater = UnscentedKalmanUpdater(model, alpha=transform.alpha, beta=transform.beta, kappa=transform.kappa)
    now = datetime(2026, 1, 1)
    prediction = GaussianStatePrediction(StateVector(m), CovarianceMatrix(P), timestamp=now)
    detection = Detection(StateVector(z), timestamp=now, measurement_model=model)
    posterior = updater.update(SingleHypothesis(prediction, detection))
    return np.asarray(posterior.state_vector, float)[:, 0], np.asarray(posterior.covar, float)


@pytest.mark.parametrize("other", ["textbook", "stone soup"])
@pytest.mark.parametrize("transform", TRANSFORMS, ids=lambda t: type(t).__name__)
def test_one_component_is_the_single_target_filter_on_delays(transform, other):
    rng = np.random.default_rng(1)
    x, P = np.array([1.1, 0.2, 0.8, -0.4]), np.array([0.05, 0.2, 0.08, 0.1])
    where = scenes.setup(clutter=0.0, p_d=1.0)
    tracker = GaussianMixturePhd(transform=transform, birth=one(x, P), p_s=1.0)
    z = delays(x) + 3e-4 * rng.standard_normal(4)
    _, estimate = tracker.step(rng, tracker.init(rng, where), Scan(0.0, [True], (Detections(z[None], [0]),)))
    R = np.eye(4) * scenes.SIGMA_S**2
    if other == "textbook":
        m, cov = literal_filter(transform, x, np.diag(P), z, delays, R)
    else:
        m, cov = stone_soup_update(transform, x, np.diag(P), z, R)
    np.testing.assert_allclose(estimate.states[0], m, rtol=0, atol=1e-12)
    np.testing.assert_allclose(estimate.covs[0], cov, rtol=0, atol=1e-12)


def test_the_whole_recursion_without_reduction_is_the_sum_over_all_histories():
    """Three scans: every component is a birth and a row (or a miss) for each later scan; the weights by plain loops."""
    rng = np.random.default_rng(2)
    motion, model = ConstantVelocity(), Position(std=0.4, probability=0.8, clutter=2.0, area=100.0)
    births = Fixed([[1, 0, 1, 0], [3, 0.2, 2, 0.1]], [[0.5, 0.1, 0.5, 0.1]], [0.3, 0.6], once=1)
    tracker = GaussianMixturePhd(motion, model, Linearised(), births, p_s=0.9, **EXACT)
    state = tracker.init(rng, setup())
    H, R, kappa = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]]), np.eye(2) * 0.16, 0.02
    known = [(births.weights[i], births.means[i], np.diag(births.variances[i])) for i in range(2)]
    parts, time_s = known[:1], 0.0
    for dt_s in (1.0, 0.5, 2.0):
        time_s += dt_s
        z = rng.uniform(0, 4, (2, 2))
        F, Q = motion.matrices(dt_s)
        parts = [(w * 0.9**dt_s, F @ m, F @ P @ F.T + Q) for w, m, P in parts]
        parts += known[1:]
        after = [(0.2 * w, m, P) for w, m, P in parts]
        for row in z:
            g = [0.8 * w * multivariate_normal(H @ m, H @ P @ H.T + R).pdf(row) for w, m, P in parts]
            for (_, m, P), share in zip(parts, g, strict=True):
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
                after.append((share / (kappa + sum(g)), m + K @ (row - H @ m), P - K @ H @ P))
        parts = after
        state, estimate = tracker.step(rng, state, scan(time_s, z))
    want = sorted(parts, key=lambda a: -a[0])
    order = np.argsort(-state.mixture.w, kind="stable")
    assert len(order) == len(want) > 40
    np.testing.assert_allclose(state.mixture.w[order], [w for w, _, _ in want], rtol=1e-9)
    np.testing.assert_allclose(state.mixture.m[order[:20]], [m for _, m, _ in want[:20]], rtol=0, atol=1e-11)
    assert estimate.count == pytest.approx(sum(w for w, _, _ in want), rel=1e-9)


def test_a_frame_that_nobody_searched_only_predicts_and_a_searched_one_without_rows_is_a_miss():
    rng = np.random.default_rng(3)
    tracker = GaussianMixturePhd(ConstantVelocity(), Position(probability=0.9, clutter=1.0), Linearised(), one([1, 1, 1, 0.0]), p_s=0.8)
    state = tracker.init(rng, setup())
    state, _ = tracker.step(rng, state, scan(0.0, [[1, 1]]))
    quiet, a = tracker.step(rng, state, scan(0.5, [], searched=[False]))
    _, b = tracker.step(rng, state, scan(0.5, [[9, 9]], searched=[False]))
    missed, _ = tracker.step(rng, state, scan(0.5, [], searched=[True]))
    w = state.mixture.w.sum()
    assert quiet.mixture.w.sum() == pytest.approx(w * 0.8**0.5, rel=1e-12)
    assert missed.mixture.w.sum() == pytest.approx(w * 0.8**0.5 * 0.1, rel=1e-9)
    np.testing.assert_allclose(
        a.states, tracker.motion.moments(state.mixture.m, state.mixture.P, state.mixture.mode, 0.5)[0][: len(a.states)]
    )
    assert identical(a, b)  # rows of a sensor that was not searched are no evidence


def test_silence_breeds_no_targets():
    tracker = GaussianMixturePhd(birth=Room(weight=0.4))
    rng, where = np.random.default_rng(0), scenes.setup()
    state = tracker.init(rng, where)
    for k in range(1, 60):
        state, estimate = tracker.step(rng, state, Scan(0.032 * k, [False]))
    assert len(estimate.states) == 0
    assert estimate.count == 0


def test_iterated_over_one_sensor_is_stacked_and_over_two_is_one_after_the_other():
    rng = np.random.default_rng(4)
    values = (ConstantVelocity(), Position(std=0.3, clutter=1.0), Linearised(), Fixed([[1, 0, 1, 0], [2, 0, 3, 0.0]], [[1.0] * 4], [0.5]))
    z, y = rng.uniform(0, 4, (3, 2)), rng.uniform(0, 4, (2, 2))
    single = [
        GaussianMixturePhd(*values, update=u).step(rng, GaussianMixturePhd(*values).init(rng, setup()), scan(1.0, z))
        for u in ("iterated", "stacked")
    ]
    assert identical(single[0][1], single[1][1])
    both = Scan(1.0, [True, True], (Detections(np.r_[z, y], [0, 0, 0, 1, 1]),))
    tracker = GaussianMixturePhd(*values)
    _, together = tracker.step(rng, tracker.init(rng, setup(2)), both)
    nothing_new = dataclasses.replace(tracker, birth=Fixed(np.zeros((0, 4)), np.zeros((0, 4)), np.zeros(0)), p_s=1.0)
    first, _ = single[0]
    _, second = nothing_new.step(rng, first, scan(1.0, y))
    assert identical(together.states, second.states)
    assert together.count == second.count


def test_births_from_the_scan_are_not_confirmed_by_the_same_scan():
    rng, where = np.random.default_rng(5), scenes.setup(clutter=1.0)
    tracker = GaussianMixturePhd(birth=FromDetections(weight=0.05))
    z = scenes.delays(np.array([[1.0, 0, 1.2, 0]]))
    state, first = tracker.step(rng, tracker.init(rng, where), Scan(0.032, [True], (Detections(z, [0]),)))
    assert len(first.states) == 0
    assert state.mixture.w.sum() == pytest.approx(0.05)
    state, second = tracker.step(rng, state, Scan(0.064, [True], (Detections(z, [0]),)))
    np.testing.assert_allclose(second.states[:, [0, 2]], [[1.0, 1.2]], atol=0.02)
    assert len(state.mixture.w) <= 2


def test_the_order_of_rows_changes_not_a_bit_nor_does_a_second_run():
    frames = scenes.scans(np.random.default_rng(6))[:15]
    turned = [
        dataclasses.replace(f, detections=tuple(dataclasses.replace(d, z=d.z[::-1], sensor=d.sensor[::-1]) for d in f.detections))
        for f in frames
    ]
    for tracker in (GaussianMixturePhd(), GaussianMixturePhd(birth=Room(per_axis=4))):
        runs = [scenes.run(tracker, scenes.setup(), f, seed) for f, seed in ((frames, 0), (turned, 0), (frames, 1))]
        assert all(identical(a, b) and identical(a, c) for a, b, c in zip(*runs, strict=True))


def test_neither_state_nor_scan_is_changed():
    frames = scenes.scans(np.random.default_rng(7))[:6]
    tracker, rng = GaussianMixturePhd(), np.random.default_rng(0)
    state = tracker.init(rng, scenes.setup())
    for frame in frames:
        state = dataclasses.replace(state, mixture=frozen(state.mixture))
        before = pickle.dumps((state, frame))
        after, _ = tracker.step(rng, state, frame)
        assert pickle.dumps((state, frame)) == before
        state = after


def test_moving_the_room_moves_the_estimates():
    shift = np.array([10.0, -4.0, 0])
    pose = np.eye(4)
    pose[:3, 3] = shift
    frames = scenes.scans(np.random.default_rng(8))[:20]
    here = scenes.setup()
    there = scenes.setup(poses=pose[None], box_m=here.box_m + shift)
    for a, b in zip(*(scenes.run(GaussianMixturePhd(), w, frames) for w in (here, there)), strict=True):
        np.testing.assert_allclose(b.states, a.states + np.array([10, 0, -4, 0]), atol=1e-6)


def test_a_pose_of_the_scan_overrides_the_setups():
    pose = np.eye(4)
    pose[0, 3] = 5.0
    x = np.array([[1.0, 0, 1.2, 0]])
    tracker = GaussianMixturePhd(birth=one([6.0, 0, 1.1, 0], np.full(4, 0.01), 0.5))
    rng = np.random.default_rng(0)
    frame = Scan(0.032, [True], (Detections(scenes.delays(x), [0]),), pose=pose[None])
    _, estimate = tracker.step(rng, tracker.init(rng, scenes.setup()), frame)
    np.testing.assert_allclose(estimate.states[:, [0, 2]], [[6.0, 1.2]], atol=0.05)


@pytest.mark.parametrize(
    ("tracker", "where", "says"),
    [
        (GaussianMixturePhd(measurement=Position(modes=5)), setup(), "one detection a target.*Position predicts up to 5"),
        (GaussianMixturePhd(update="stacked"), scenes.setup(False), "reads one sensor, measurement Tdoa reads 4.*pair/0"),
        (GaussianMixturePhd(), setup(), "kind 'tdoa'"),
    ],
)
def test_what_does_not_fit_is_refused_at_init_by_name(tracker, where, says):
    with pytest.raises(SetupError, match=says):
        tracker.init(np.random.default_rng(0), where)


def test_a_scan_from_the_past_is_refused():
    tracker, rng = GaussianMixturePhd(), np.random.default_rng(0)
    state, _ = tracker.step(rng, tracker.init(rng, scenes.setup()), Scan(1.0, [False]))
    with pytest.raises(InputError, match="time order"):
        tracker.step(rng, state, Scan(0.9, [False]))


@pytest.mark.parametrize("values", [{"p_s": 1.1}, {"update": "joint"}, {"max_components": 0}, {"prune_weight": -1.0}])
def test_impossible_parameters_are_refused(values):
    with pytest.raises(ValueError):
        GaussianMixturePhd(**values)


@pytest.mark.parametrize("birth", [chen_births(), FromDetections(), Room(per_axis=4)], ids=lambda b: type(b).__name__)
def test_three_talkers_are_tracked_through_seven_false_rows_a_scan(birth):
    estimates = scenes.run(GaussianMixturePhd(birth=birth), scenes.setup(), scenes.scans(np.random.default_rng(9)))
    assert scenes.mean_ospa(estimates) < 0.35  # nobody is 1.5


def test_single_pairs_are_tracked_by_the_iterated_corrector():
    frames = scenes.scans(np.random.default_rng(10), stacked=False, clutter=1.0, p_d=0.9)
    estimates = scenes.run(GaussianMixturePhd(), scenes.setup(False, clutter=1.0, p_d=0.9), frames)
    assert scenes.mean_ospa(estimates) < 0.9


def test_three_dimensions_run():
    tracker = GaussianMixturePhd(motion=Langevin(dims=3), birth=Room(per_axis=3))
    estimates = scenes.run(tracker, scenes.setup(), scenes.scans(np.random.default_rng(11))[:10])
    assert all(e.states.shape[1] == 6 for e in estimates)


@pytest.mark.study
def test_chen_scene_over_ten_seeds_with_the_consistent_clutter_density():
    """papers: OSPA over the full state about .72 at 25 dB; position-only is lower. The three transforms agree within .01."""
    seeds = range(10)
    means = {}
    for transform in TRANSFORMS:
        tracker = GaussianMixturePhd(transform=transform, birth=chen_births())
        means[type(transform)] = np.mean(
            [scenes.mean_ospa(scenes.run(tracker, scenes.setup(), scenes.scans(np.random.default_rng(100 + s)))) for s in seeds]
        )
    assert max(means.values()) < 0.3
    assert max(means.values()) - min(means.values()) < 0.02


def test_a_row_without_one_pair_is_the_row_of_a_sensor_without_that_pair():
    z = scenes.delays(np.array([[1.0, 0, 1.2, 0]]))
    z[0, 1] = 1.5e-3  # nonsense, and marked so
    rng, where = np.random.default_rng(0), scenes.setup(clutter=2.0)
    (stack,) = where.sensors
    three = dataclasses.replace(stack, space=Space.of("a", "b", "c"), pairs=stack.pairs[[0, 2, 3]])
    tracker = GaussianMixturePhd(birth=one([1.05, 0, 1.1, 0], np.full(4, 0.01), 0.5))
    marked = Scan(0.032, [True], (Detections(z, [0], valid=[[True, False, True, True]]),))
    state, a = tracker.step(rng, tracker.init(rng, where), marked)
    without = tracker.init(rng, dataclasses.replace(where, sensors=(three,)))
    other, b = tracker.step(rng, without, Scan(0.032, [True], (Detections(z[:, [0, 2, 3]], [0]),)))
    assert len(a.states) == 1
    np.testing.assert_allclose(a.states, b.states, rtol=0, atol=1e-12)
    np.testing.assert_allclose(state.mixture.w, other.mixture.w, rtol=1e-10)
    _, fooled = tracker.step(rng, tracker.init(rng, where), Scan(0.032, [True], (Detections(z, [0]),)))
    assert len(fooled.states) == 0
