"""OSPA(2) against its definition by enumeration, and what it is for: labels."""

import dataclasses
import itertools

import numpy as np
import pytest
from scoring_tracks import SPACE, made, random

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench.types import Estimate
from sonobench_plugins.metric.ospa import Ospa
from sonobench_plugins.metric.ospa2 import Ospa2


def by_definition(truth, found, frames, p, q, c, window):
    """Beard, Vo & Vo 2020, eq. 22 to 24, over every assignment of tracks."""
    out = []
    for k in range(1, frames + 1):
        times = [t for t in range(1, k + 1) if window is None or t > k - window]
        cut = [[{t: x for t, x in track.items() if t in times} for track in side.values()] for side in (truth, found)]
        few, many = sorted(([track for track in side if track] for side in cut), key=len)

        def base(f, g):
            domain = set(f) | set(g)
            parts = [min(np.hypot(*np.subtract(f[t], g[t])), c) if t in f and t in g else c for t in domain]
            return (np.mean(np.array(parts) ** q)) ** (1 / q)

        if not many:
            out.append(0.0)
            continue
        d = np.array([[base(f, g) for g in many] for f in few]).reshape(len(few), len(many))
        best = min(sum(d[i, j] ** p for i, j in enumerate(choice)) for choice in itertools.permutations(range(len(many)), len(few)))
        out.append(((best + c**p * (len(many) - len(few))) / len(many)) ** (1 / p))
    return np.array(out)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("window", [None, 1, 3])
def test_it_is_the_definition(seed, window):
    rng = np.random.default_rng(seed)
    truth, found = random(rng, 3), {n + 7: t for n, t in random(rng, 4).items()}
    truth[0] = truth.get(0) or {1: (0.0, 0.0)}
    truth[0][8] = (0.5, 0.5)  # as long as the frames
    p, q, c = ((1, 1), (2, 1), (2, 2))[seed % 3] + (0.6,)
    metric = Ospa2(p=p, q=q, c_m=c, window_s=window)
    values = metric.evaluate(*made(truth, found), SPACE)[""].values
    np.testing.assert_allclose(values, by_definition(truth, found, 8, p, q, c, window), rtol=1e-12, atol=1e-14)


def test_a_window_of_one_frame_is_ospa():
    rng = np.random.default_rng(1)
    known, estimates = made(random(rng, 3), random(rng, 3))
    tracks, sets = Ospa2(p=2.0, window_s=1.0).evaluate(known, estimates, SPACE), Ospa(p=2.0).evaluate(known, estimates, SPACE)
    for column in ("", "localisation", "cardinality"):
        np.testing.assert_allclose(tracks[column].values, sets[column].values, rtol=1e-12, atol=1e-15)


def test_a_label_that_changes_half_way_costs_though_every_place_is_right():
    track = {k: (0.1 * k, 0.0) for k in range(1, 9)}
    broken = {5: {k: x for k, x in track.items() if k < 5}, 6: {k: x for k, x in track.items() if k >= 5}}
    exact = Ospa2().evaluate(*made({1: track}, {9: track}), SPACE)[""].values
    apart = Ospa2().evaluate(*made({1: track}, broken), SPACE)[""].values
    np.testing.assert_array_equal(exact, 0.0)
    np.testing.assert_allclose(apart[[3, 7]], [0.0, 0.75])  # one of two tracks is half right, the other false
    assert Ospa().evaluate(*made({1: track}, broken), SPACE)[""].values.max() == 0


def test_names_and_the_order_of_rows_do_not_matter():
    rng = np.random.default_rng(3)
    truth, found = random(rng, 3), random(rng, 4)
    other = {99 - n: found[n] for n in reversed(found)}
    a, b = (Ospa2(window_s=3.0).evaluate(*made(truth, f), SPACE)[""].values for f in (found, other))
    np.testing.assert_allclose(a, b, rtol=1e-13)


def test_unlabelled_estimates_are_undefined_and_a_failed_trial_is_the_cut_off():
    known, estimates = made({1: {1: (0, 0), 2: (0, 0)}}, {1: {1: (0, 0), 2: (0, 0)}})
    bare = [dataclasses.replace(e, labels=None) for e in estimates]
    rows = score(Ospa2(), known, bare, SPACE)
    assert [r.metric for r in rows] == ["ospa2", "ospa2.localisation", "ospa2.cardinality"]
    assert all(np.isnan(r.value) and r.coverage == 0 for r in rows)
    assert score(Ospa2(c_m=0.5), known, [], None)[0].value == 0.5


def test_one_label_twice_in_an_estimate_is_refused():
    known, _ = made({1: {1: (0, 0)}}, {})
    with pytest.raises(InputError, match=r"labels \[4, 4\] at 1.0 s; a track is at one place"):
        Ospa2().evaluate(known, [Estimate(1.0, np.zeros((2, 2)), labels=np.array([4, 4]))], SPACE)


@pytest.mark.parametrize("values", [{"p": 0.5}, {"q": 0.0}, {"q": 99.0}, {"c_m": 0.0}, {"window_s": 0.0}])
def test_impossible_parameters_are_refused(values):
    with pytest.raises(InputError):
        Ospa2(**values)
