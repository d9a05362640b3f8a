"""GOSPA against its two definitions and its axioms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scoring_brute import brute_gospa, distances
from scoring_scenes import XY, sets, truth

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench_plugins.metric.gospa import Gospa, gospa
from sonobench_plugins.metric.ospa import ospa

orders = st.sampled_from([1.0, 2.0, 3.5])
cuts = st.floats(0.1, 5.0)
alphas = st.sampled_from([0.5, 1.0, 2.0])
points = st.integers(0, 4).flatmap(lambda n: arrays(float, (n, 2), elements=st.floats(-3, 3, width=32)))


def value(x, y, **parameters):
    return score(Gospa(**parameters), *sets(x, y))[0].value


@given(points, points, cuts, orders, alphas)
def test_it_is_the_minimum_over_all_matchings(x, y, c, p, alpha):
    assert value(x, y, p=p, c_m=c, alpha=alpha) == pytest.approx(brute_gospa(distances(x, y), c, p, alpha), abs=1e-7)


@pytest.mark.parametrize("p", [1.0, 2.0, 4.0])
def test_it_is_the_minimum_where_sets_are_crowded_so_that_the_order_decides_the_assignment(p):
    rng = np.random.default_rng(4)
    for _ in range(150):
        x, y = rng.normal(size=(rng.integers(2, 5), 2)), rng.normal(size=(rng.integers(2, 5), 2))
        assert value(x, y, p=p, c_m=4.0) == pytest.approx(brute_gospa(distances(x, y), 4.0, p), abs=1e-9)


@settings(max_examples=200)
@given(points, points, points, cuts, orders, alphas)
def test_it_is_a_metric(x, y, z, c, p, alpha):
    def between(a, b):
        return value(a, b, p=p, c_m=c, alpha=alpha)

    assert between(x, x[::-1]) == 0.0
    assert between(x, y) == pytest.approx(between(y, x), abs=1e-12)
    assert between(x, z) <= between(x, y) + between(y, z) + 1e-9


@given(points, points, cuts, orders, alphas)
def test_the_powers_of_its_parts_add_up(x, y, c, p, alpha):
    whole, *parts = gospa(distances(x, y), c, p, alpha)
    assert sum(part**p for part in parts) == pytest.approx(whole**p, rel=1e-9, abs=1e-12)


@given(points, points, cuts, orders)
def test_at_alpha_1_it_is_ospa_without_the_division_by_the_size(x, y, c, p):
    size = max(len(x), len(y), 1)
    assert gospa(distances(x, y), c, p, 1.0)[0] == pytest.approx(size ** (1 / p) * ospa(distances(x, y), c, p)[0], abs=1e-9)


def test_missed_and_false_are_priced_apart_and_a_far_pair_is_both():
    whole, near, missed, false = gospa(distances(np.array([[0, 0], [9, 9]]), np.array([[0.3, 0], [5, 5]])), 1.0, 2.0)
    assert (near, missed, false) == (pytest.approx(0.3), pytest.approx(0.5**0.5), pytest.approx(0.5**0.5))
    assert whole == pytest.approx((0.09 + 0.5 + 0.5) ** 0.5)


def test_a_failed_trial_misses_everybody():
    scene = truth([[[0, 0], [1, 1]], [[0, 0], [1, 1]]])
    rows = {r.metric: r.value for r in score(Gospa(c_m=2.0), scene, [], None)}
    assert rows == {"gospa": pytest.approx(2.0), "gospa.localisation": 0, "gospa.missed": pytest.approx(2.0), "gospa.false": 0}


@given(points, points)
def test_it_never_exceeds_stone_soups_which_assigns_on_d(x, y):
    from datetime import datetime

    from stonesoup.metricgenerator.ospametric import GOSPAMetric
    from stonesoup.types.state import State

    now = datetime(2026, 1, 1)
    left, right = ([State(r.reshape(2, 1), timestamp=now) for r in rows] for rows in (y, x))
    if not left and not right:  # Stone Soup needs a time stamp from one of them
        return
    theirs, _ = GOSPAMetric(c=1.0, p=2.0).compute_gospa_metric(left, right)
    assert value(x, y) <= theirs.value["distance"] + 1e-9


@pytest.mark.parametrize("bad", [{"p": 0.9}, {"p": float("inf")}, {"c_m": -1.0}, {"alpha": 0.0}, {"alpha": 2.5}])
def test_parameters_outside_the_definition_are_refused(bad):
    with pytest.raises(InputError, match=str(next(iter(bad.values())))):
        Gospa(**bad)


def test_a_frame_without_anybody_costs_nothing():
    assert score(Gospa(), truth([[[0, 0]]], exists=[[0]]), [], XY)[0].value == 0.0
