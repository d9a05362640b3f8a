"""The labelled multi-Bernoulli filter beside the Kalman filter, closed forms and the enumeration of every association."""

import itertools
import pickle

import numpy as np
import pytest
from phd_linear import Position, scan, setup
from scipy.stats import multivariate_normal

from sonobench.protocols import Tracker
from sonobench.types import Scan, identical
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.lmb import LabelledMultiBernoulli
from sonobench_plugins.transform.linearised import Linearised

EXACT = {"prune_weight": 0.0, "merge_distance": 0.0, "max_components": 10**6}
H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])


def born(means, w):
    """Components of covariance .2 I, at the start only."""
    means = np.array(means, float)
    return Fixed(means, np.full((1, 4), 0.2), np.array(w, float), once=len(means))


def tracker_of(means, w, p_d=0.9, clutter=0.5, **other):
    return LabelledMultiBernoulli(ConstantVelocity(), Position(probability=p_d, clutter=clutter), Linearised(), born(means, w), **other)


def run(tracker, scans, sensors=1):
    rng = np.random.default_rng(0)
    state, estimates = tracker.init(rng, setup(sensors)), []
    for one in scans:
        state, estimate = tracker.step(rng, state, one)
        estimates.append(estimate)
    return state, estimates


def test_fits_the_role_and_pickles():
    tracker = LabelledMultiBernoulli()
    assert isinstance(tracker, Tracker)
    assert pickle.loads(pickle.dumps(tracker)) == tracker
    state, _ = run(tracker_of([[1, 0, 2, 0]], [0.5]), [scan(0.1, [[1, 2]])])
    assert identical(pickle.loads(pickle.dumps(state)).mixture, state.mixture)


def test_one_target_always_detected_without_clutter_is_the_kalman_filter():
    rng = np.random.default_rng(0)
    tracker = tracker_of([[1, 0.5, 2, -0.3]], [1.0], p_d=1.0, clutter=0.0, p_s=1.0)
    m, P, R, time_s = np.array([1, 0.5, 2, -0.3]), np.eye(4) * 0.2, np.eye(2) * 0.01, 0.0
    state = tracker.init(rng, setup())
    for dt_s in (0.5, 0.1, 0.0, 1.7):
        time_s += dt_s
        F, Q = tracker.motion.matrices(dt_s)
        m, P = F @ m, F @ P @ F.T + Q
        z = H @ m + 0.1 * rng.standard_normal(2)
        S = H @ P @ H.T + R
        K = P @ H.T @ np.linalg.inv(S)
        m, P = m + K @ (z - H @ m), P - K @ S @ K.T
        state, estimate = tracker.step(rng, state, scan(time_s, [z]))
        np.testing.assert_allclose(estimate.states, [m], rtol=0, atol=1e-12)
        np.testing.assert_allclose(estimate.covs, [P], rtol=0, atol=1e-12)
        np.testing.assert_allclose(estimate.existence, [1], atol=1e-12)


def enumerated(means, r, z, p_d, clutter):
    """Existence of each track and its mean, summed over every set of tracks that exist and every association of rows."""
    n, m, kappa = len(r), len(z), clutter / 100.0
    S = 0.2 * np.eye(2) + 0.01 * np.eye(2)
    K = 0.2 * H.T @ np.linalg.inv(S)
    g = np.array([[multivariate_normal.pdf(row, H @ mean, S) for row in z] for mean in means])
    total, existence, first = 0.0, np.zeros(n), np.zeros((n, 4))
    for present in itertools.product([0, 1], repeat=n):
        for joint in itertools.product(range(m + 1), repeat=n):
            used = [j for j in joint if j]
            if len(set(used)) < len(used) or any(j and not e for j, e in zip(joint, present, strict=True)):
                continue
            weight = kappa ** (m - len(used))
            for i, (e, j) in enumerate(zip(present, joint, strict=True)):
                weight *= (1 - r[i]) if not e else r[i] * ((1 - p_d) if j == 0 else p_d * g[i, j - 1])
            total += weight
            for i, (e, j) in enumerate(zip(present, joint, strict=True)):
                mean = means[i] + (K @ (z[j - 1] - H @ means[i]) if j else 0)
                existence[i] += weight * e
                first[i] += weight * e * mean
    return existence / total, first / existence[:, None]


def test_an_update_is_the_sum_over_every_set_of_tracks_and_every_association():
    means = np.array([[1.0, 0, 1, 0], [1.3, 0, 1.2, 0], [3, 0, 3, 0]])
    r, z = [0.7, 0.9, 0.3], np.array([[1.1, 1.1], [1.4, 1.0], [2.6, 3.2]])
    tracker = tracker_of(means, r, extract_existence=0.0, **EXACT)
    _, (estimate,) = run(tracker, [scan(0.0, z)])
    existence, mean = enumerated(means, r, z, 0.9, 0.5)
    np.testing.assert_allclose(estimate.existence, existence, atol=1e-9)
    np.testing.assert_allclose(estimate.states, mean, atol=1e-9)
    assert estimate.count == pytest.approx(existence.sum())


def test_a_missed_track_keeps_r_times_its_miss_over_what_may_be():
    _, (estimate,) = run(tracker_of([[1, 0, 2, 0]], [0.999], p_d=0.98), [scan(0.0, np.zeros((0, 2)))])
    assert estimate.existence[0] == pytest.approx(0.999 * 0.02 / (1 - 0.999 * 0.98))
    assert estimate.existence[0] > 0.9


def test_a_label_stays_with_its_track_and_is_never_reused():
    rows = [[[1, 1], [3, 3]], [[1, 1]], [[3, 3], [1, 1]], [[3, 3]], [[3, 3]], [[3, 3]], [[3, 3]]]
    scans = [scan(1.0 + k, z) for k, z in enumerate(rows)]
    _, estimates = run(tracker_of([[1, 0, 1, 0], [3, 0, 3, 0]], [0.9, 0.9], p_d=0.98, clutter=0.01), scans)
    for estimate in estimates[:3]:
        at = dict(zip(estimate.labels, estimate.states[:, 0], strict=True))
        assert at[0] == pytest.approx(1, abs=0.3)
        assert at[1] == pytest.approx(3, abs=0.3)
    assert estimates[-1].labels.tolist() == [1]


def test_the_order_of_rows_does_not_matter():
    z = np.array([[1.1, 1.1], [1.4, 1.0], [2.6, 3.2]])
    tracker = tracker_of([[1, 0, 1, 0], [1.3, 0, 1.2, 0]], [0.7, 0.9])
    assert identical(run(tracker, [scan(0.1, z)])[1], run(tracker, [scan(0.1, z[::-1])])[1])


def test_rows_with_a_missing_component_are_used_through_the_other():
    z = np.array([[1.5, 99.0]])
    valid = np.array([[True, False]])
    _, (estimate,) = run(tracker_of([[1, 0, 1, 0]], [0.9], p_d=1.0), [scan(0.1, z, valid=valid)])
    assert estimate.states[0, 0] > 1.4
    assert estimate.states[0, 2] == 1


def test_two_sensors_tell_more_than_one():
    one = scan(0.1, [[1.1, 1.0]])
    both = Scan(0.1, [True, True], (type(one.detections[0])([[1.1, 1.0], [1.1, 1.0]], [0, 1]),))
    tracker = tracker_of([[1, 0, 1, 0]], [0.5])
    assert run(tracker, [both], sensors=2)[1][0].existence > run(tracker, [one])[1][0].existence


def test_an_unsearched_scan_only_predicts():
    tracker = tracker_of([[1, 1, 1, 0]], [0.9], p_s=1.0)
    _, (first, second) = run(tracker, [scan(1.0, [[1, 1]]), scan(2.0, np.zeros((0, 2)), searched=(False,))])
    assert second.existence[0] == pytest.approx(first.existence[0])
    assert second.states[0, 0] == pytest.approx(first.states[0, 0] + first.states[0, 1])


@pytest.mark.parametrize("wrong", [{"p_s": 1.5}, {"update": "both"}, {"max_components": 0}])
def test_impossible_parameters_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        LabelledMultiBernoulli(**wrong)
