"""The δ-GLMB filter beside an enumeration of every history of every set of labels, and what labels are for."""

import itertools
import pickle

import numpy as np
import pytest
from phd_linear import Position, scan, setup
from scipy.stats import multivariate_normal

from sonobench.filtering.glmb import existence
from sonobench.protocols import Tracker
from sonobench.types import Scan, identical
from sonobench_plugins.birth.fixed import Fixed
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.delta_glmb import DeltaGlmb
from sonobench_plugins.tracker.lmb import LabelledMultiBernoulli
from sonobench_plugins.transform.linearised import Linearised

H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0]])
R = np.eye(2) * 0.01
EVERYTHING = {"truncation": "murty", "max_hypotheses": 10**6, "prune_weight": 0.0}
PLACES = np.array([[1.0, 0.2, 1.0, 0.0], [1.3, 0.0, 1.2, 0.1]])
ROWS = ([[1.05, 1.1], [1.4, 1.1], [3.0, 3.0]], [[1.2, 1.1]], [[1.3, 1.1], [1.35, 1.3]])


def tracker_of(means, w, p_d=0.9, clutter=0.5, once=True, **other):
    means = np.array(means, float)
    birth = Fixed(means, np.full((1, 4), 0.2), np.array(w, float), once=len(means) if once else 0)
    return DeltaGlmb(ConstantVelocity(), Position(probability=p_d, clutter=clutter), Linearised(), birth, **other)


def run(tracker, scans, sensors=1, seed=0):
    rng = np.random.default_rng(seed)
    state, estimates = tracker.init(rng, setup(sensors)), []
    for one in scans:
        state, estimate = tracker.step(rng, state, one)
        estimates.append(estimate)
    return state, estimates


def kalman(motion, mean, history):
    """Mean, covariance and the product of row densities of a birth at `mean` that since then had these rows (None: missed)."""
    m, P, density, first = np.array(mean), np.eye(4) * 0.2, 1.0, True
    for row in history:
        if not first:
            F, Q = motion.matrices(1.0)
            m, P = F @ m, F @ P @ F.T + Q
        first = False
        if row is not None:
            S = H @ P @ H.T + R
            density *= multivariate_normal.pdf(row, H @ m, S)
            K = P @ H.T @ np.linalg.inv(S)
            m, P = m + K @ (np.array(row) - H @ m), P - K @ S @ K.T
    return m, P, density


def histories(frames, born, last_rows):
    """Every life of a label born (or not) in frame `born`: () is never, else for each frame a row's number, or −1 for a miss, until it is gone."""
    yield ()
    for end in range(born + 1, frames + 1):
        yield from itertools.product(*([-1, *range(last_rows[k])] for k in range(born, end)))


def enumerated(means, r, rows, p_d, clutter, p_s, motion):
    """{(label's life, …): weight} over every combination of lives in which no two labels share a row; labels are (frame, place)."""
    frames, kappa = len(rows), clutter / 100.0
    labels = [(k, b) for k in range(frames) for b in range(len(means))]
    options = []
    for k, b in labels:
        own = []
        for life in histories(frames, k, [len(z) for z in rows]):
            if not life:
                own.append((life, 1 - r[b], ()))
                continue
            _, _, density = kalman(motion, means[b], [None if j < 0 else rows[k + i][j] for i, j in enumerate(life)])
            weight = r[b] * p_s ** (len(life) - 1) * density
            weight *= np.prod([1 - p_d if j < 0 else p_d / kappa for j in life])
            weight *= 1 - p_s if k + len(life) < frames else 1.0
            own.append((life, weight, tuple((k + i, j) for i, j in enumerate(life) if j >= 0)))
        options.append(own)
    found = {}

    def extend(i, lives, weight, used):
        if i == len(options):
            found[lives] = weight
            return
        for life, w, mine in options[i]:
            if not used & set(mine):
                extend(i + 1, (*lives, life), weight * w, used | set(mine))

    extend(0, (), 1.0, frozenset())
    return labels, found


def posterior(means, r, rows, p_d, clutter, p_s, motion):
    """From the enumeration: P(number), existence of each label, and the mean of each in the heaviest hypothesis of the likeliest number."""
    labels, found = enumerated(means, r, rows, p_d, clutter, p_s, motion)
    total, now = sum(found.values()), {}
    for lives, weight in found.items():
        alive = tuple(life if k + len(life) == len(rows) and life else None for (k, _), life in zip(labels, lives, strict=True))
        now[alive] = now.get(alive, 0.0) + weight / total
    number, exists = np.zeros(len(labels) + 1), np.zeros(len(labels))
    for alive, weight in now.items():
        there = np.array([life is not None for life in alive])
        number[there.sum()] += weight
        exists += weight * there
    best = max((a for a in now if sum(x is not None for x in a) == number.argmax()), key=now.get)
    states = {
        i: kalman(motion, means[b], [None if j < 0 else rows[k + n][j] for n, j in enumerate(life)])[0]
        for i, ((k, b), life) in enumerate(zip(labels, best, strict=True))
        if life is not None
    }
    return len(now), number, exists, states


def test_fits_the_role_and_pickles():
    tracker = DeltaGlmb()
    assert isinstance(tracker, Tracker)
    assert pickle.loads(pickle.dumps(tracker)) == tracker
    state, _ = run(tracker_of([[1, 0, 2, 0]], [0.5]), [scan(0.1, [[1, 2]])])
    assert identical(pickle.loads(pickle.dumps(state)).tracks, state.tracks)


@pytest.mark.parametrize(("truncation", "frames"), [("murty", 2), ("gibbs", 2), ("murty", 3), ("gibbs", 3)])
def test_it_is_the_enumeration_of_every_life_of_every_label(truncation, frames):
    r, p_s, rows = [0.3, 0.2], 0.8, ROWS[-frames:]
    means = PLACES if frames == 2 else PLACES[:1]
    tracker = tracker_of(means, r[: len(means)], once=False, p_s=p_s, **{**EVERYTHING, "truncation": truncation, "samples": 60_000})
    state, estimates = run(tracker, [scan(1.0 + k, z) for k, z in enumerate(rows)])
    count, number, exists, states = posterior(means, r, rows, 0.9, 0.5, p_s, tracker.motion)
    close = {"atol": 1e-9} if truncation == "murty" else {"atol": 1e-3}
    sizes = (state.hypotheses.of >= 0).sum(axis=1)
    np.testing.assert_allclose(np.bincount(sizes, np.exp(state.hypotheses.log_w), len(number)), number, **close)
    ours = np.zeros(len(exists))
    ours[state.labels] = existence(state.hypotheses)
    np.testing.assert_allclose(ours, exists, **close)
    assert estimates[-1].labels.tolist() == list(states)
    np.testing.assert_allclose(estimates[-1].states, list(states.values()), atol=1e-9)
    assert estimates[-1].count == pytest.approx(exists.sum(), abs=2e-3)
    if truncation == "murty":
        assert len(state.hypotheses.log_w) == count


def test_one_update_has_the_marginals_of_the_lmb():
    z, birth = ROWS[0], Fixed(PLACES, np.full((1, 4), 0.2), np.array([0.7, 0.9]), once=2)
    models = (ConstantVelocity(), Position(probability=0.9, clutter=0.5), Linearised(), birth)
    lmb = LabelledMultiBernoulli(*models, prune_weight=0.0, merge_distance=0.0, extract_existence=0.0)
    _, (theirs,) = run(lmb, [scan(0.1, z)])
    state, (ours,) = run(DeltaGlmb(*models, **EVERYTHING), [scan(0.1, z)])
    np.testing.assert_allclose(existence(state.hypotheses), theirs.existence, atol=1e-12)
    assert ours.count == pytest.approx(theirs.count, abs=1e-12)


def test_the_heaviest_hypotheses_are_kept_whatever_their_number():
    scans = [scan(1.0 + k, z) for k, z in enumerate(ROWS)]
    every, _ = run(tracker_of(PLACES, [0.3, 0.2], once=False, **EVERYTHING), scans[:2])
    few, _ = run(tracker_of(PLACES, [0.3, 0.2], once=False, truncation="murty", max_hypotheses=20, prune_weight=0.0), scans[:2])
    assert len(few.hypotheses.log_w) <= 20
    assert np.exp(every.hypotheses.log_w[0]) == pytest.approx(np.exp(few.hypotheses.log_w[0]), rel=0.1)


def test_one_target_always_detected_without_clutter_is_the_kalman_filter():
    tracker = tracker_of([[1, 0.5, 2, -0.3]], [1.0], p_d=1.0, clutter=0.0, p_s=1.0)
    rows = [[1.5, 1.7], [2.0, 1.4], [2.4, 1.2]]
    _, estimates = run(tracker, [scan(float(k), [z]) for k, z in enumerate(rows)])
    for k, estimate in enumerate(estimates, 1):
        m, P, _ = kalman(tracker.motion, [1, 0.5, 2, -0.3], rows[:k])
        np.testing.assert_allclose(estimate.states, [m], rtol=0, atol=1e-12)
        np.testing.assert_allclose(estimate.covs, [P], rtol=0, atol=1e-12)


@pytest.mark.parametrize("truncation", ["gibbs", "murty"])
def test_labels_stay_with_targets_that_cross_and_are_never_reused(truncation):
    t = np.arange(12.0)
    a, b = np.c_[1 + 0.5 * t, 1 + 0.5 * t], np.c_[1 + 0.5 * t, 6.5 - 0.5 * t]
    rng = np.random.default_rng(0)
    scans = [scan(k, rng.permutation([a[int(k)], b[int(k)]] + 0.03 * rng.standard_normal((2, 2)))) for k in t]
    tracker = tracker_of([[1, 0.5, 1, 0.5], [1, 0.5, 6.5, -0.5]], [0.9, 0.9], p_d=0.98, clutter=0.5, truncation=truncation)
    _, estimates = run(tracker, scans)
    for k, estimate in enumerate(estimates):
        at = dict(zip(estimate.labels, estimate.states[:, [0, 2]], strict=True))
        np.testing.assert_allclose(at[0], a[k], atol=0.3)
        np.testing.assert_allclose(at[1], b[k], atol=0.3)


def test_a_target_that_is_gone_leaves_the_other_its_label():
    rows = [[[1, 1], [3, 3]], [[1, 1], [3, 3]], [[3, 3]], [[3, 3]], [[3, 3]], [[3, 3]]]
    tracker = tracker_of([[1, 0, 1, 0], [3, 0, 3, 0]], [0.9, 0.9], p_d=0.98, clutter=0.01)
    _, estimates = run(tracker, [scan(1.0 + k, z) for k, z in enumerate(rows)])
    assert [e.labels.tolist() for e in estimates] == [[0, 1], [0, 1], *[[1]] * 4] or estimates[-1].labels.tolist() == [1]


def test_two_sensors_tell_more_than_one_and_only_the_first_lets_targets_die():
    one = scan(0.1, [[1.1, 1.0]])
    both = Scan(0.1, [True, True], (type(one.detections[0])([[1.1, 1.0], [1.1, 1.0]], [0, 1]),))
    tracker = tracker_of([[1, 0, 1, 0]], [0.5], **EVERYTHING)
    assert run(tracker, [both], sensors=2)[1][0].count > run(tracker, [one])[1][0].count
    blind = tracker_of([[1, 0, 1, 0]], [0.5], p_d=0.0, p_s=0.5, **EVERYTHING)
    nothing = [scan(1.0, [], searched=(True, True)), scan(2.0, [], searched=(True, True))]
    assert run(blind, nothing, sensors=2)[1][-1].count == pytest.approx(0.5**3)


def test_an_unsearched_scan_only_predicts():
    tracker = tracker_of([[1, 1, 1, 0]], [0.9], p_s=1.0)
    _, (first, second) = run(tracker, [scan(1.0, [[1, 1]]), scan(2.0, np.zeros((0, 2)), searched=(False,))])
    assert second.count == pytest.approx(first.count)
    assert second.states[0, 0] == pytest.approx(first.states[0, 0] + first.states[0, 1])


def test_rows_with_a_missing_component_are_used_through_the_other():
    _, (estimate,) = run(tracker_of([[1, 0, 1, 0]], [0.9], p_d=1.0), [scan(0.1, [[1.5, 99.0]], valid=np.array([[True, False]]))])
    assert estimate.states[0, 0] > 1.4
    assert estimate.states[0, 2] == 1


@pytest.mark.parametrize("wrong", [{"p_s": 1.5}, {"truncation": "best"}, {"max_hypotheses": 0}])
def test_impossible_parameters_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        DeltaGlmb(**wrong)
