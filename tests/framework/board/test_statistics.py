"""Intervals, ranks, sign flips, Holm, letters."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy import stats

from sonobench.board import statistics as s
from sonobench.board.bootstrap import bootstrap
from sonobench.board.pooling import Units

small = st.integers(1, 6).flatmap(lambda n: arrays(float, (n, 3), elements=st.integers(-4, 4).map(float)))


def interval(values):
    """Of one column of unit values."""
    values = np.asarray(values, float)[:, None]
    return s.intervals(bootstrap(Units(values, np.arange(1), "scenarios", np.arange(len(values)))))[0]


def fixed(array):
    array = np.asarray(array, float)
    array.flags.writeable = False
    return array


@given(small)
def test_sign_flip_counts_the_patterns_that_reach_the_observed_sum(d):
    patterns = list(itertools.product((1, -1), repeat=len(d)))
    expected = [np.mean([abs(np.dot(p, column)) >= abs(column.sum()) - 1e-9 for p in patterns]) for column in d.T]
    np.testing.assert_allclose(s.sign_flip(fixed(d)), expected)


def test_many_units_are_flipped_at_random_with_the_same_answer_each_time():
    d = fixed(np.random.default_rng(3).normal(0.4, 1.0, (20, 2)))
    p = s.sign_flip(d)
    np.testing.assert_array_equal(p, s.sign_flip(d))
    np.testing.assert_allclose(p, [stats.ttest_1samp(column, 0).pvalue for column in d.T], atol=0.02)


def test_holm_is_the_textbook_example():
    np.testing.assert_allclose(s.holm(fixed([0.01, 0.04, 0.03, 0.005])), [0.03, 0.06, 0.06, 0.02])
    np.testing.assert_allclose(s.holm(fixed([0.9, 0.8])), [1.0, 1.0])


@pytest.mark.parametrize(("comparisons", "units"), [(1, 6), (7, 9), (28, 11)])
def test_the_units_that_exact_tests_need_are_the_published_ones(comparisons, units):
    assert s.units_needed(comparisons) == units
    assert comparisons * 2 / 2**units < 0.05 <= comparisons * 2 / 2 ** (units - 1)


def test_two_pipelines_that_differ_in_each_of_six_units_are_separated_and_five_are_not_enough():
    for units, smallest in ((6, 2 / 64), (5, 2 / 32)):
        assert s.sign_flip(np.ones((units, 1)) + np.arange(units)[:, None])[0] == pytest.approx(smallest)


@given(st.integers(1, 6), st.data())
def test_two_items_share_a_letter_exactly_when_they_are_not_separated(size, data):
    pairs = list(itertools.combinations(range(size), 2))
    separated = data.draw(st.sets(st.sampled_from(pairs))) if pairs else set()
    found = s.letters(size, sorted(separated))
    assert "a" in found[0]
    for i, j in pairs:
        assert bool(set(found[i]) & set(found[j])) == ((i, j) not in separated)


def test_few_units_have_students_interval_and_one_has_none():
    values = fixed([1.0, 2.0, 4.0])
    low, high, method = interval(values)
    np.testing.assert_allclose((low, high), stats.t.interval(0.95, 2, values.mean(), stats.sem(values)))
    assert method == "t"
    assert math.isnan(interval(values[:1]).low)


def test_the_bootstrap_t_interval_leans_to_the_long_tail_and_moves_with_its_values():
    values = fixed(np.random.default_rng(0).lognormal(0, 1, 15))
    low, high, method = interval(values)
    assert method == "bootstrap-t"
    assert high - values.mean() > 1.3 * (values.mean() - low)
    np.testing.assert_allclose(interval(values * 3 + 7)[:2], (low * 3 + 7, high * 3 + 7))
    assert interval(values) == (low, high, method)


def test_an_interval_of_equal_values_is_a_point_and_near_equal_ones_fall_back_to_students():
    assert interval(fixed(np.full(8, 1 / 3)))[:2] == pytest.approx((1 / 3, 1 / 3))
    assert interval(fixed([0, 0, 0, 0, 0, 0, 1])).method == "t"


def test_equal_means_share_a_rank():
    np.testing.assert_array_equal(s.ranks(fixed([0.3, 0.1 + 0.2, 0.1, 0.9])), [2, 2, 1, 4])


def test_rank_intervals_are_sharp_where_all_units_agree_and_wide_where_they_do_not():
    x = np.random.default_rng(0).normal(size=(12, 1)) + np.array([0.0, 5.0, 5.0])
    x[:, 1:] += np.random.default_rng(1).normal(size=(12, 2))
    low, high = s.rank_intervals(bootstrap(Units(fixed(x), np.arange(3), "scenarios", np.arange(12))).values)
    assert (low.tolist(), high.tolist()) == ([1, 2, 2], [1, 3, 3])


def test_skewed_differences_are_noticed():
    even = np.linspace(-1, 1, 12)
    assert s.skewed(fixed(np.stack([even, np.exp(4 * even), np.ones(12)], axis=1))).tolist() == [False, True, False]


@pytest.mark.parametrize(("units", "least"), [(6, 0.91), (10, 0.93)])
def test_the_bootstrap_t_interval_covers_the_mean_of_normal_units(units, least):
    rng = np.random.default_rng(11)
    found = [interval(row) for row in rng.normal(size=(400, units))]
    assert least - 0.03 < np.mean([low <= 0 <= high for low, high, _ in found]) < 0.985  # 3 standard errors of 400 draws


@pytest.mark.study
@pytest.mark.parametrize(("draw", "covered"), [("normal", 0.95), ("exponential", 0.92)])
def test_coverage_over_ten_scenes_is_what_the_simulations_say(draw, covered):
    rng = np.random.default_rng(5)
    values = rng.normal(1, 1, (3000, 10)) if draw == "normal" else rng.exponential(1, (3000, 10))
    found = [interval(row) for row in values]
    assert np.mean([low <= 1 <= high for low, high, _ in found]) == pytest.approx(covered, abs=0.02)
