"""Alignment and pooling."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scoring_scenes import XY, estimates, truth

from sonobench.errors import InputError, SetupError
from sonobench.protocols import Series
from sonobench.scoring import aligned, pooled, score
from sonobench.types import Space

STILL = np.zeros((5, 1, 2))


def held(frames):
    return [f.estimates[:, 0].tolist() for f in frames]


@dataclass(frozen=True)
class Fixed:
    """A metric of given columns."""

    columns: Any

    def evaluate(self, truth, output, space):
        return self.columns


def one(series, k=3, **more):
    return score(Fixed({"": series}), truth(np.zeros((k, 1, 2)), **more), [], None)


def test_the_last_estimate_at_or_before_an_instant_stands_there():
    out = estimates([[[0, 0]], [[1, 0]], [[2, 0]], [[3, 0]], [[4, 0]]], time_s=[-0.2, 0.8, 1.8, 2.8, 3.8])
    assert held(aligned(truth(STILL), out, XY).frames) == [[0], [1], [2], [3], [4]]


def test_an_estimate_stands_for_one_and_a_half_periods_and_no_longer():
    out = estimates([[[0, 0]], [[1, 0]]], time_s=[0.0, 0.6])
    assert held(aligned(truth(STILL), out, XY).frames) == [[0], [1], [1], [], []]
    assert held(aligned(truth(STILL), out, XY, hold_s=2.4).frames) == [[0], [1], [1], [1], []]
    assert held(aligned(truth(STILL), out, XY, hold_s=0.0).frames) == [[0], [], [], [], []]


def test_the_longer_of_both_periods_decides_how_long_an_estimate_stands():
    fine = truth(np.zeros((9, 1, 2)), period_s=0.25)
    assert held(aligned(fine, estimates([[[0, 0]], [[1, 0]], [[2, 0]]]), XY).frames) == [[0]] * 4 + [[1]] * 4 + [[2]]


@pytest.mark.parametrize("epoch", [0.0, 1.7e9])
@given(period=st.floats(0.005, 0.2), steps=st.integers(2, 300))
def test_equal_instants_that_differ_by_rounding_are_equal(epoch, period, steps):
    exact = epoch + np.arange(steps) * period
    summed = epoch + np.cumsum(np.full(steps, period)) - period
    out = estimates(np.arange(steps).reshape(-1, 1, 1) * [[1.0, 0.0]], time_s=summed)
    frames = aligned(truth(np.zeros((steps, 1, 2)), time_s=exact, period_s=period), out, XY).frames
    assert held(frames) == [[i] for i in range(steps)]


def test_no_estimate_looks_ahead():
    out = estimates([[[7, 0]]], time_s=[2.1])
    assert held(aligned(truth(STILL), out, XY).frames) == [[], [], [], [7], []]


def test_instants_that_are_not_valid_are_not_scored():
    frames = aligned(truth(STILL, valid=[True, False, True, True, False]), [], XY).frames
    assert [f.time_s for f in frames] == [0, 2, 3]


def test_targets_are_those_that_exist_or_those_that_sound():
    scene = truth([[[0, 0], [1, 0], [2, 0]]], exists=[[1, 1, 0]], active=[[0, 1, 0]])
    assert aligned(scene, [], XY).frames[0].truth[:, 0].tolist() == [0, 1]
    assert aligned(scene, [], XY).frames[0].active.tolist() == [False, True]
    assert aligned(scene, [], XY, targets="active").frames[0].truth[:, 0].tolist() == [1]
    with pytest.raises(InputError, match="'loud'"):
        aligned(scene, [], XY, targets="loud")


def test_columns_are_matched_by_name_whatever_their_order():
    scene = truth([[[1, 2, 3]]], velocity=[[[4, 5, 6]]])
    space = Space.of("vy_m_s", "z_m", "x_m", "y_m")
    output = estimates([[[50, 30, 10, 20]]])
    pairs = aligned(scene, output, space)
    assert (pairs.space.names, pairs.unit) == (("x_m", "y_m", "z_m"), "m")
    np.testing.assert_array_equal(pairs.frames[0].estimates, [[10, 20, 30]])
    full = aligned(scene, output, space, components=("y_m", "vy_m_s"))
    np.testing.assert_array_equal(full.frames[0].truth, [[2, 5]])
    np.testing.assert_array_equal(full.frames[0].estimates, [[20, 50]])
    assert full.unit == "mixed"


def test_a_planar_tracker_is_compared_in_the_plane():
    pairs = aligned(truth([[[1, 2, 3]]]), estimates([[[1, 2]]]), XY)
    assert pairs.distances(pairs.frames[0]).tolist() == [[0.0]]


def test_missing_components_are_refused_with_both_sides_named():
    with pytest.raises(SetupError, match=r"vx_m_s.*estimates have \['x_m', 'y_m'\].*truth has \['x_m', 'y_m', 'z_m'\]"):
        aligned(truth(STILL), [], XY, components=("x_m", "vx_m_s"))
    with pytest.raises(SetupError, match="a position or a direction"):
        aligned(truth(STILL), [], Space.of("range_m"))


def test_directions_are_those_seen_from_the_origin_that_the_truth_names_and_wrap():
    around = truth([[[1 - 1, 1 - 1e-3, 1.0]]], parameters={"origin_x_m": 1, "origin_y_m": 1, "origin_z_m": 1})
    space = Space.of("azimuth_rad", "elevation_rad")
    pairs = aligned(around, estimates([[[math.pi - 1e-3, 0.0]]]), space)
    assert pairs.distances(pairs.frames[0]) == pytest.approx(2e-3, rel=1e-3)
    assert pairs.unit == "rad"
    with pytest.raises(SetupError, match="origin_x_m"):
        aligned(truth(STILL), [], space)


@pytest.mark.parametrize(
    ("pool", "weights", "expected"),
    [
        ("mean", [1, 0, 0, 3], 2.5),
        ("rms", [1, 4, 0, 1], math.sqrt(26 / 6)),
        ("median", [1, 1, 0, 2], 2.5),
        ("rate", [2, 1, 0, 1], 6 / 4),
    ],
)
def test_values_pool_over_frames_as_the_series_says(pool, weights, expected):
    [row] = one(Series(np.array([1.0, 2.0, np.nan, 3.0]), np.array(weights, float), "m", pool=pool), 4)
    assert row.value == pytest.approx(expected)


@given(st.lists(st.tuples(st.floats(-5, 5), st.integers(0, 4)), min_size=1, max_size=12))
def test_a_weighted_median_is_the_median_of_repeated_values(pairs):
    v, w = np.array(pairs).T
    expected = np.repeat(v, w.astype(int))
    result = pooled(v, w, "median")
    assert math.isnan(result) if not len(expected) else result == pytest.approx(np.median(expected))


def test_frame_rms_keeps_one_row_an_instant_named_by_its_index():
    rows = one(Series(np.array([1.0, np.nan]), np.array([1.0, 0.0]), "m", pool="frame-rms"), valid=[True, False, True])
    assert [(r.slice, r.weight, r.pool) for r in rows] == [("0", 1.0, "frame-rms"), ("2", 0.0, "frame-rms")]
    assert rows[0].value == 1.0
    assert math.isnan(rows[1].value)


def test_where_nothing_is_defined_worst_stands_in_and_without_one_the_value_is_nan_with_coverage_0():
    nothing = {"values": np.zeros(0), "weights": np.zeros(0), "unit": "m", "coverage": 0.0}
    [bare] = one(Series(**nothing))
    assert math.isnan(bare.value)
    assert (bare.weight, bare.coverage) == (0.0, 0.0)
    [filled] = one(Series(**nothing, worst=9.0))
    assert (filled.value, filled.weight, filled.coverage) == (9.0, 3.0, 1.0)


@pytest.mark.parametrize(("pool", "expected"), [("mean", 0.25 * 1 + 0.75 * 9), ("rate", 0.25 * 1 + 0.75 * 9), ("median", 9.0)])
def test_the_share_that_is_not_covered_counts_as_worst(pool, expected):
    [row] = one(Series(np.ones(2), np.ones(2), "m", pool=pool, worst=9.0, coverage=0.25))
    assert (row.value, row.weight, row.coverage) == (pytest.approx(expected), pytest.approx(8.0), 1.0)


def test_worst_fills_the_instants_that_frame_rms_lacks():
    series = Series(np.array([1.0, np.nan, np.nan]), np.array([1.0, 0.0, 0.0]), "m", pool="frame-rms", worst=9.0, coverage=1 / 3)
    assert [(r.value, r.weight) for r in one(series)] == [(1.0, 1.0), (9.0, 1.0), (9.0, 1.0)]


def test_rows_are_named_by_metric_and_column():
    ones = Series(np.ones(3), np.ones(3), "m")
    rows = score(Fixed({"": ones, "missed": ones}), truth(np.zeros((3, 1, 2))), [], None, name="gospa")
    assert [r.metric for r in rows] == ["gospa", "gospa.missed"]
    assert one(ones)[0].metric == "fixed"


@pytest.mark.parametrize(
    ("series", "message"),
    [
        (Series(np.ones(3), np.ones(2), "m"), "two vectors of one length"),
        (Series(np.array([np.nan]), np.ones(1), "m"), "NaN where its weight is above 0"),
        (Series(np.ones(2), np.ones(2), "m", pool="frame-rms"), "2 values for 3 valid times"),
        (Series(np.ones(2), np.ones(2), "m", pool="max"), "pool is 'max'"),  # type: ignore[arg-type]
    ],
)
def test_a_malformed_series_is_refused(series, message):
    with pytest.raises(InputError, match=message):
        one(series)


@pytest.mark.parametrize("columns", [{"": [1.0, 2.0]}, [1.0], None])
def test_what_is_no_column_of_series_is_refused_by_name(columns):
    with pytest.raises(InputError, match="metric mine: evaluate must return"):
        score(Fixed(columns), truth(np.zeros((3, 1, 2))), [], None, name="mine")
