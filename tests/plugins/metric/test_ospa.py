"""OSPA against its definition, its axioms, and an independent library."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scoring_brute import brute_ospa, distances
from scoring_scenes import XY, estimates, sets, truth

from sonobench.errors import InputError
from sonobench.scoring import score
from sonobench.types import Space
from sonobench_plugins.metric.ospa import Ospa, bottleneck, ospa

orders = st.sampled_from([1.0, 2.0, 3.5, math.inf])
cuts = st.floats(0.1, 5.0)
points = st.integers(0, 4).flatmap(lambda n: arrays(float, (n, 2), elements=st.floats(-3, 3, width=32)))


def value(x, y, **parameters):
    return score(Ospa(**parameters), *sets(x, y))[0].value


@given(points, points, cuts, st.sampled_from([1.0, 2.0, math.inf]))
def test_it_is_the_minimum_over_all_assignments(x, y, c, p):
    assert value(x, y, p=p, c_m=c) == pytest.approx(brute_ospa(distances(x, y), c, p), abs=1e-9)


@pytest.mark.parametrize("p", [1.0, 2.0, math.inf])
def test_it_is_the_minimum_where_sets_are_crowded_so_that_the_order_decides_the_assignment(p):
    rng = np.random.default_rng(4)
    for _ in range(150):
        x, y = rng.normal(size=(rng.integers(2, 5), 2)), rng.normal(size=(rng.integers(2, 5), 2))
        assert value(x, y, p=p, c_m=4.0) == pytest.approx(brute_ospa(distances(x, y), 4.0, p), abs=1e-9)


@given(points, cuts, orders)
def test_a_set_is_at_distance_0_from_itself_in_any_order(x, c, p):
    assert value(x, x[::-1], p=p, c_m=c) == 0.0


@given(points, points, cuts, orders)
def test_it_is_symmetric(x, y, c, p):
    assert value(x, y, p=p, c_m=c) == pytest.approx(value(y, x, p=p, c_m=c), abs=1e-12)


@settings(max_examples=200)
@given(points, points, points, cuts, orders)
def test_it_satisfies_the_triangle_inequality(x, y, z, c, p):
    assert value(x, z, p=p, c_m=c) <= value(x, y, p=p, c_m=c) + value(y, z, p=p, c_m=c) + 1e-9


@given(points, points, cuts, orders)
def test_it_lies_between_0_and_the_cut_off_and_its_parts_add_up(x, y, c, p):
    whole, near, absent = ospa(distances(x, y), c, p)
    assert 0 <= whole <= c * (1 + 1e-12)
    expected = max(near, absent) if math.isinf(p) else (near**p + absent**p) ** (1 / p)
    assert whole == pytest.approx(expected, rel=1e-6, abs=1e-9)


@given(points, points, cuts)
def test_the_order_infinity_is_the_limit_of_large_orders(x, y, c):
    d = distances(x, y)
    n = max(*d.shape, 1)
    assert ospa(d, c, 400.0)[0] == pytest.approx(ospa(d, c, math.inf)[0], rel=2 * math.log(n) / 400 + 1e-6, abs=1e-3 * c)


@pytest.mark.parametrize("p", [1.0, 2.0, math.inf])
def test_both_sets_empty_is_0_and_one_empty_is_the_cut_off(p):
    assert value([], [], p=p, c_m=0.7) == 0.0
    assert value([[1, 1]], [], p=p, c_m=0.7) == pytest.approx(0.7)
    assert value([], [[1, 1], [2, 2]], p=p, c_m=0.7) == pytest.approx(0.7)


def test_the_bottleneck_assignment_is_not_the_one_of_least_sum():
    cost = np.array([[0.0, 2.0], [2.0, 3.0]])
    assert bottleneck(cost) == 2.0
    assert ospa(cost, 5.0, math.inf)[0] == 2.0


def test_stone_soup_assigns_on_d_and_so_exceeds_the_metric_at_p_2():
    """The least sum of d pairs 0 with 0 and leaves one pair far apart; the least sum of d² does not."""
    from datetime import datetime

    from stonesoup.metricgenerator.ospametric import OSPAMetric
    from stonesoup.types.state import State

    x, y = np.array([[0.0, 0.0], [1.9, 0.7]]), np.array([[0.0, 0.0], [-1.9, 0.7]])
    now = datetime(2026, 1, 1)
    theirs = OSPAMetric(c=10.0, p=2.0).compute_OSPA_distance(
        [State(r.reshape(2, 1), timestamp=now) for r in y], [State(r.reshape(2, 1), timestamp=now) for r in x]
    )
    ours = value(x, y, p=2.0, c_m=10.0)
    assert ours == pytest.approx(brute_ospa(distances(x, y), 10.0, 2.0))
    assert theirs.value > 1.2 * ours
    assert value(x, y, p=1.0, c_m=10.0) == pytest.approx(brute_ospa(distances(x, y), 10.0, 1.0))


def test_the_trial_is_the_mean_over_frames_and_a_failed_trial_is_empty_output():
    scene = truth([[[0, 0]], [[0, 0]], [[0, 0]]], exists=[[1], [1], [0]])
    output = estimates([[[0.3, 0]], np.zeros((0, 2)), np.zeros((0, 2))])
    rows = {r.metric: r for r in score(Ospa(c_m=1.0), scene, output, XY)}
    assert rows["ospa"].value == pytest.approx((0.3 + 1 + 0) / 3)
    assert rows["ospa.localisation"].value == pytest.approx(0.1)
    assert rows["ospa.cardinality"].value == pytest.approx(1 / 3)
    failed = score(Ospa(c_m=1.0), scene, [], None)[0]
    assert (failed.value, failed.coverage, failed.unit) == (pytest.approx(2 / 3), 1.0, "m")


def test_stated_components_are_compared_and_metres_with_speeds_are_called_mixed():
    scene = truth([[[0, 0, 0]]], velocity=[[[1, 0, 0]]])
    output = estimates([[[0.0, 0.5, 0.0, 0.0]]])
    space = Space.of("x_m", "vx_m_s", "y_m", "vy_m_s")
    assert score(Ospa(), scene, output, space)[0].value == 0.0
    full = score(Ospa(components=space.names, c_m=1.5), scene, output, space)[0]
    assert (full.value, full.unit) == (0.5, "mixed")


def test_only_sounding_targets_count_where_asked():
    scene = truth([[[0, 0], [5, 5]]], active=[[1, 0]])
    assert score(Ospa(targets="active"), scene, estimates([[[0, 0]]]), XY)[0].value == 0.0
    assert score(Ospa(), scene, estimates([[[0, 0]]]), XY)[0].value == pytest.approx(math.sqrt(0.5))


def test_angles_wrap():
    scene = truth([[[-1.0, -1e-3, 0.0]]], parameters={"origin_x_m": 0, "origin_y_m": 0, "origin_z_m": 0})
    output = estimates([[[math.pi - 1e-3, 0.0]]])
    row = score(Ospa(), scene, output, Space.of("azimuth_rad", "elevation_rad"))[0]
    assert (row.value, row.unit) == (pytest.approx(2e-3, rel=1e-3), "rad")


@pytest.mark.parametrize("bad", [{"p": 0.5}, {"p": math.nan}, {"c_m": 0.0}, {"c_m": math.inf}, {"targets": "loud"}])
def test_parameters_outside_the_definition_are_refused(bad):
    with pytest.raises(InputError, match=str(next(iter(bad.values())))):
        value([[0, 0]], [[0, 0]], **bad)
