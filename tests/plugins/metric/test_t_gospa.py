"""T-GOSPA against its definition by dynamic programming over every assignment, against the paper's own programme, and against GOSPA."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.optimize import linprog
from scoring_tracks import SPACE, made, random

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench.types import Estimate, Space, Truth
from sonobench_plugins.metric.gospa import Gospa
from sonobench_plugins.metric.t_gospa import TGospa

FRAMES = 5


def base(f, g, k, c, p):
    """D_k of two tracks {k: point}, either of which may be None (nobody)."""
    here, there = (None if t is None else t.get(k) for t in (f, g))
    if here is None or there is None:
        return 0.0 if here is None and there is None else c**p / 2
    return min(np.hypot(*np.subtract(here, there)), c) ** p


def assignments(n, m):
    """Every injective partial map of n targets to m tracks, as tuples of a track's number or None."""
    for choice in itertools.product([None, *range(m)], repeat=n):
        used = [j for j in choice if j is not None]
        if len(set(used)) == len(used):
            yield choice


def by_programming(truth, found, frames, p, c, gamma):
    """The definition with whole assignments: the cheapest path through all of them, time by time."""
    X, Y = list(truth.values()), list(found.values())
    states = list(assignments(len(X), len(Y)))

    def here(choice, k):
        cost = sum(base(x, None if j is None else Y[j], k, c, p) for x, j in zip(X, choice, strict=True))
        return cost + sum(base(None, y, k, c, p) for j, y in enumerate(Y) if j not in choice)

    def turn(a, b):
        return gamma**p / 2 * sum((i != j) * ((i is not None) + (j is not None)) for i, j in zip(a, b, strict=True))

    best = {a: here(a, 1) for a in states}
    for k in range(2, frames + 1):
        best = {b: here(b, k) + min(best[a] + turn(a, b) for a in states) for b in states}
    return (min(best.values()) / frames) ** (1 / p)


def by_matrices(truth, found, frames, p, c, gamma):
    """Eq. 23 to 26 as printed: matrices W_k of n + 1 by m + 1 with the dummy row and column, and e above each |change|."""
    X, Y = [*truth.values(), None], [*found.values(), None]
    n, m = len(X) - 1, len(Y) - 1
    size, pairs = (n + 1) * (m + 1), n * m
    w = lambda k, i, j: k * size + i * (m + 1) + j  # noqa: E731
    e = lambda k, i, j: frames * size + k * pairs + i * m + j  # noqa: E731
    total = frames * size + (frames - 1) * pairs
    cost = np.zeros(total)
    equal, right, below = [], [], []
    for k in range(frames):
        for i, j in itertools.product(range(n + 1), range(m + 1)):
            cost[w(k, i, j)] = 0.0 if i == n and j == m else base(X[i], Y[j], k + 1, c, p)
        for i in range(n):
            equal.append([w(k, i, j) for j in range(m + 1)])
        for j in range(m):
            equal.append([w(k, i, j) for i in range(n + 1)])
    for k, i, j in itertools.product(range(frames - 1), range(n), range(m)):
        cost[e(k, i, j)] = gamma**p / 2
        below += [(w(k, i, j), w(k + 1, i, j), e(k, i, j)), (w(k + 1, i, j), w(k, i, j), e(k, i, j))]
    A, B = np.zeros((len(equal), total)), np.zeros((len(below), total))
    for r, columns in enumerate(equal):
        A[r, columns] = 1.0
        right.append(1.0)
    for r, (plus, minus, bound) in enumerate(below):
        B[r, [plus, minus, bound]] = [1.0, -1.0, -1.0]
    result = linprog(cost, A_ub=B if len(below) else None, b_ub=np.zeros(len(below)) if below else None, A_eq=A, b_eq=right)
    return (result.fun / frames) ** (1 / p)


def tracks(seed):
    rng = np.random.default_rng(seed)
    truth = random(rng, 3, FRAMES, 0.8)
    found = {
        n + 7: {k: tuple(np.add(x, 0.15 * rng.standard_normal(2))) for k, x in t.items() if rng.random() < 0.8} for n, t in truth.items()
    }
    found = {n: t for n, t in found.items() if t} | {50 + n: t for n, t in random(rng, 1, FRAMES, 0.5).items()}
    if 7 in found and 8 in found:  # labels that swap half way
        a, b = found[7], found[8]
        found[7] = {k: x for k, x in a.items() if k < 3} | {k: x for k, x in b.items() if k >= 3}
        found[8] = {k: x for k, x in b.items() if k < 3} | {k: x for k, x in a.items() if k >= 3}
    truth.setdefault(0, {})[FRAMES] = (0.5, 0.5)  # as long as the frames
    return truth, found


@pytest.mark.parametrize("seed", range(8))
def test_it_is_the_definition(seed):
    truth, found = tracks(seed)
    p, c, gamma = ((1.0, 0.6, 0.3), (2.0, 0.6, 0.5), (2.0, 0.4, 0.1))[seed % 3]
    columns = TGospa(p=p, c_m=c, switch_m=gamma).evaluate(*made(truth, found), SPACE)
    (ours,) = columns[""].values
    assert ours == pytest.approx(by_matrices(truth, found, FRAMES, p, c, gamma), rel=1e-7)
    assert ours == pytest.approx(by_programming(truth, found, FRAMES, p, c, gamma), rel=1e-7)  # whole assignments are optimal here
    assert ours**p == pytest.approx(sum(columns[name].values[0] ** p for name in ("localisation", "missed", "false", "switch")))


@pytest.mark.parametrize("p", [1.0, 2.0])
def test_at_one_time_it_is_gospa(p):
    rng = np.random.default_rng(4)
    known, estimates = made(random(rng, 4, 1, 1.0), random(rng, 3, 1, 1.0))
    ours, theirs = (m.evaluate(known, estimates, SPACE) for m in (TGospa(p=p, c_m=0.5), Gospa(p=p, c_m=0.5)))
    for column in ("", "localisation", "missed", "false"):
        np.testing.assert_allclose(ours[column].values, theirs[column].values, atol=1e-9)


def test_a_label_that_changes_costs_one_switch_and_a_break_half_of_one_on_each_side():
    track = {k: (0.1 * k, 0.0) for k in range(1, 9)}
    other = {5: {k: x for k, x in track.items() if k < 5}, 6: {k: x for k, x in track.items() if k >= 5}}
    metric = TGospa(p=1.0, c_m=1.0, switch_m=0.4)
    apart = metric.evaluate(*made({1: track}, other), SPACE)
    assert apart["switch"].values[0] == pytest.approx(0.4 / 8)
    assert apart[""].values[0] == pytest.approx(0.4 / 8)
    hole = metric.evaluate(*made({1: track}, {5: {k: x for k, x in track.items() if k not in (4, 5)}}), SPACE)
    assert hole[""].values[0] == pytest.approx(2 * 0.5 / 8)  # missed twice; the assignment may stay, so there is no switch


def test_directions_are_compared_by_their_angle():
    """Two degrees of azimuth at an elevation of 80 degrees are .35 degrees apart."""
    angles = np.radians([[0.0, 80.0], [2.0, 80.0]])
    point = np.array([np.cos(angles[0, 1]), 0.0, np.sin(angles[0, 1])])
    here = {"origin_x_m": 0.0, "origin_y_m": 0.0, "origin_z_m": 0.0}
    ones = np.ones((1, 1), bool)
    truth = Truth(np.ones(1), np.array([1]), point[None, None], ones, ones, period_s=1.0, parameters=here)
    estimates = [Estimate(1.0, angles[1:], labels=np.array([3]))]
    (found,) = TGospa(c_m=0.1).evaluate(truth, estimates, Space.of("azimuth_rad", "elevation_rad"))[""].values
    assert np.degrees(found) == pytest.approx(2 * np.cos(np.radians(80)), rel=1e-3)


def test_unlabelled_estimates_are_undefined_and_a_failed_trial_misses_everybody():
    known, estimates = made({1: {1: (0, 0), 2: (0, 0)}}, {1: {1: (0, 0), 2: (0, 0)}})
    rows = score(TGospa(), known, [dataclasses.replace(e, labels=None) for e in estimates], SPACE)
    assert all(np.isnan(r.value) and r.coverage == 0 for r in rows)
    assert score(TGospa(p=1.0, c_m=0.5), known, [], None, "t-gospa")[0].value == 0.25


def test_one_label_twice_in_an_estimate_is_refused():
    known, _ = made({1: {1: (0, 0)}}, {})
    with pytest.raises(InputError, match=r"labels \[4, 4\] at 1.0 s"):
        TGospa().evaluate(known, [Estimate(1.0, np.zeros((2, 2)), labels=np.array([4, 4]))], SPACE)


@pytest.mark.parametrize("values", [{"p": 0.5}, {"c_m": 0.0}, {"switch_m": 0.0}])
def test_impossible_parameters_are_refused(values):
    with pytest.raises(InputError):
        TGospa(**values)
