"""Multi-Bernoulli filters: of detections beside their printed equations and the Bayes filter of one target, of fields beside field-lmb."""

import itertools
import pickle

import numpy as np
import pytest
from phd_linear import Position, mixture, scan, setup
from scipy.stats import multivariate_normal

from sonobench.filtering.bernoulli import updated
from sonobench.protocols import Tracker
from sonobench.testing import fixtures
from sonobench.types import identical
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.cbmember import CbMember
from sonobench_plugins.tracker.field_lmb import FieldLmb
from sonobench_plugins.tracker.gm_cbmember import GaussianCbMember, existence
from sonobench_plugins.transform.linearised import Linearised

H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
EXACT = {"prune_existence": 0.0, "prune_weight": 0.0, "merge_distance": 0.0, "max_components": 10**6}
PLACES = np.array([[1.0, 0, 1, 0], [1.3, 0, 1.2, 0], [3, 0, 3, 0]])


def tracker_of(means, r, p_d=0.98, clutter=0.5, **other):
    means = np.array(means, float)
    birth = Fixed(means, np.full((1, 4), 0.2), np.array(r, float), once=len(means))
    return GaussianCbMember(ConstantVelocity(), Position(probability=p_d, clutter=clutter), Linearised(), birth, **other)


def run(tracker, scans, where=None):
    rng = np.random.default_rng(0)
    state, estimates = tracker.init(rng, where or setup()), []
    for one in scans:
        state, estimate = tracker.step(rng, state, one)
        estimates.append(estimate)
    return state, estimates


def densities(z):
    return np.array([[multivariate_normal.pdf(row, H @ mean, 0.21 * np.eye(2)) for row in z] for mean in PLACES])


def test_they_fit_the_role_and_pickle():
    for tracker in (CbMember(), GaussianCbMember()):
        assert isinstance(tracker, Tracker)
        assert pickle.loads(pickle.dumps(tracker)) == tracker


def test_an_update_is_the_printed_one():
    """Eq. 38 to 45 of Vo, Vo & Cantoni 2009, target by target and row by row."""
    r, p_d, kappa, z = np.array([0.7, 0.9, 0.3]), 0.98, 0.5 / 100, np.array([[1.1, 1.1], [2.6, 3.2]])
    state, (estimate,) = run(tracker_of(PLACES, r, p_d, **EXACT), [scan(0.0, z)])
    rho = p_d * densities(z)
    missed = r * (1 - p_d) / (1 - r * p_d)
    above = sum(r[i] * (1 - r[i]) * rho[i] / (1 - r[i] * p_d) ** 2 for i in range(3))
    rows = above / (kappa + sum(r[i] * rho[i] / (1 - r[i] * p_d) for i in range(3)))
    np.testing.assert_allclose(existence(state.mixture), [*missed, *rows], rtol=1e-9)
    for j in range(2):
        own = np.flatnonzero(state.mixture.mode == 3 + j)
        share = r / (1 - r) * rho[:, j]
        order = np.argsort(-share)  # merging leaves the heaviest first
        np.testing.assert_allclose(state.mixture.w[own], rows[j] * share[order] / share.sum(), rtol=1e-9)
        K = 0.2 * H.T / 0.21
        np.testing.assert_allclose(state.mixture.m[own], [m + K @ (z[j] - H @ m) for m in PLACES[order]], rtol=1e-9)
    assert estimate.labels is None
    assert estimate.count == pytest.approx(missed.sum() + rows.sum())


def expected_number(r, z, p_d, kappa):
    """Of the Bayes filter, summed over every set of targets and every association."""
    g, total, number = densities(z), 0.0, 0.0
    for present in itertools.product([0, 1], repeat=3):
        for joint in itertools.product(range(len(z) + 1), repeat=3):
            used = [j for j in joint if j]
            if len(set(used)) < len(used) or any(j and not e for j, e in zip(joint, present, strict=True)):
                continue
            weight = kappa ** (len(z) - len(used))
            for i, (e, j) in enumerate(zip(present, joint, strict=True)):
                weight *= (1 - r[i]) if not e else r[i] * ((1 - p_d) if j == 0 else p_d * g[i, j - 1])
            total, number = total + weight, number + weight * sum(present)
    return number / total


def test_of_one_target_the_number_is_that_of_the_bayes_filter():
    """For one target the balanced number is exact: the generating functional's derivative is."""
    z, p_d, kappa = np.array([[1.1, 1.1]]), 0.9, 0.005
    _, (estimate,) = run(tracker_of(PLACES[:1], [0.4], p_d, **EXACT), [scan(0.0, z)])
    assert estimate.count == pytest.approx(expected_number([0.4, 0, 0], z, p_d, kappa), rel=1e-9)


def test_of_three_targets_the_number_is_nearly_that_of_the_bayes_filter():
    r, z = [0.7, 0.9, 0.8], np.array([[1.1, 1.1], [1.4, 1.0], [2.6, 3.2]])
    _, (estimate,) = run(tracker_of(PLACES, r, 0.98, **EXACT), [scan(0.0, z)])
    assert estimate.count == pytest.approx(expected_number(r, z, 0.98, 0.005), abs=0.15)


def test_targets_come_and_go():
    rows = [[[1, 1], [3, 3]]] * 4 + [[[3, 3]]] * 4
    _, estimates = run(tracker_of([[1, 0, 1, 0], [3, 0, 3, 0]], [0.9, 0.9], clutter=0.01), [scan(1.0 + k, z) for k, z in enumerate(rows)])
    assert [len(e.states) for e in estimates[1:4]] == [2, 2, 2]
    assert [len(e.states) for e in estimates[6:]] == [1, 1]


def test_rows_in_any_order_and_unsearched_scans():
    z = np.array([[1.1, 1.1], [1.4, 1.0], [2.6, 3.2]])
    tracker = tracker_of(PLACES, [0.7, 0.9, 0.5], p_s=1.0)
    assert identical(run(tracker, [scan(0.1, z)])[1], run(tracker, [scan(0.1, z[::-1])])[1])
    _, (first, second) = run(tracker, [scan(1.0, z), scan(2.0, np.zeros((0, 2)), searched=(False,))])
    assert second.count == pytest.approx(first.count)


def test_on_fields_it_is_field_lmb_without_names():
    where = fixtures.setup("pairs")
    scans = fixtures.scans(where, fixtures.regular(6))
    _, theirs = run(FieldLmb(particles=50, report="cardinality"), scans, where)
    state, ours = run(CbMember(particles=50), scans, where)
    for a, b in zip(ours, theirs, strict=True):
        assert a.labels is None
        assert identical((a.states, a.covs, a.existence, a.count), (b.states, b.covs, b.existence, b.count))
    assert ours[-1].info["targets"] == len(state.tracks.r)


def test_on_a_field_each_target_is_a_bernoulli_filter():
    where = fixtures.setup("pairs")
    one = fixtures.scans(where, fixtures.regular(1))[0]
    birth = Fixed(np.array([[1.0, 0, 0.9, 0], [3.0, 0, 2.1, 0]]), np.full((1, 4), 0.01), np.array([0.2, 0.6]), once=2)
    tracker = CbMember(birth=birth, particles=60, merge_distance=0.0, prune_existence=0.0)
    rng = np.random.default_rng(0)
    before = tracker.init(rng, where)
    x, _ = tracker.motion.sample(np.random.default_rng(5), before.tracks.x.reshape(-1, 4), before.tracks.mode.reshape(-1), one.time_s)
    after, _ = tracker.step(np.random.default_rng(5), before, one)
    log_g = before.likelihood.log_ratio(x, one).reshape(2, -1)
    for i, r in enumerate((0.2, 0.6)):
        r *= tracker.p_s ** (one.time_s / where.period_s)
        there, _ = updated(1 - r, np.log(np.full(60, r / 60)), log_g[i])
        assert after.tracks.r[i] == pytest.approx(there, rel=1e-9)


@pytest.mark.parametrize("wrong", [{"p_s": 1.5}, {"update": "both"}, {"max_components": 0}])
def test_impossible_parameters_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        GaussianCbMember(**wrong)
    with pytest.raises(ValueError):
        CbMember(particles=0)


def test_existence_adds_up_by_target():
    some = mixture(np.random.default_rng(0), 6)._replace(mode=np.array([0, 1, 1, 2, 0, 2]))
    assert existence(some)[1] == pytest.approx(some.w[1] + some.w[2])
