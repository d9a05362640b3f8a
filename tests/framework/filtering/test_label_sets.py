"""Existence of labels against the sums over sets of labels, written out."""

from itertools import chain, combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sonobench.filtering.label_sets import (
    best_set,
    cardinality,
    heard,
    sets_cardinality,
    sets_existence,
    sets_heard,
    sets_kept,
    sets_of,
    sets_survived,
)

PROBABILITIES = st.lists(st.floats(0.001, 0.999), min_size=1, max_size=5)


def subsets(n):
    return list(chain.from_iterable(combinations(range(n), k) for k in range(n + 1)))


def at(sets, members):
    return sets[tuple(int(i in members) for i in range(sets.ndim))]


@given(PROBABILITIES, st.floats(0.5, 1.0), st.integers(0, 2**31))
def test_an_lmb_and_its_sets_stay_the_same_through_prediction_and_update(r, p_s, seed):
    r, log_eta = np.array(r), 6 * np.random.default_rng(seed).standard_normal(len(r))
    sets = sets_heard(sets_survived(sets_of(r), p_s), log_eta)
    np.testing.assert_allclose(sets_existence(sets), heard(r * p_s, log_eta), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(sets, sets_of(heard(r * p_s, log_eta)), rtol=1e-9, atol=1e-13)
    np.testing.assert_allclose(sets_cardinality(sets), cardinality(heard(r * p_s, log_eta)), atol=1e-12)


@pytest.mark.parametrize("n", [1, 3, 4])
def test_sets_of_any_weights_are_predicted_and_updated_as_the_glmb_says(n):
    rng = np.random.default_rng(n)
    w = rng.random((2,) * n)
    w /= w.sum()
    log_eta, p_s = rng.standard_normal(n), 0.8
    found = sets_heard(sets_survived(w, p_s), log_eta)
    wanted = {}
    for L in subsets(n):
        predicted = sum(at(w, I) * p_s ** len(L) * (1 - p_s) ** (len(I) - len(L)) for I in subsets(n) if set(L) <= set(I))
        wanted[L] = predicted * np.prod([np.exp(log_eta[i]) for i in L])
    total = sum(wanted.values())
    for L, weight in wanted.items():
        assert at(found, L) == pytest.approx(weight / total, rel=1e-12)


def test_who_is_left_out_is_summed_out():
    r = np.array([0.2, 0.7, 0.4])
    np.testing.assert_allclose(sets_kept(sets_of(r), np.array([0, 2])), sets_of(r[[0, 2]]), atol=1e-15)
    assert sets_kept(sets_of(r), np.zeros(0, np.int64)).shape == ()


def test_the_best_set_of_a_size_has_the_likeliest_labels():
    r = np.array([0.2, 0.7, 0.4, 0.9])
    assert best_set(sets_of(r), 2).tolist() == [1, 3]
    assert best_set(sets_of(r), 0).tolist() == []
    assert best_set(np.ones(()), 0).tolist() == []


def test_what_is_impossible_ends_a_label_and_what_is_certain_stays():
    np.testing.assert_array_equal(heard(np.array([0.5, 1.0, 0.0]), np.array([-np.inf, -3.0, 5.0])), [0.0, 1.0, 0.0])
    with pytest.raises(ValueError, match="no set of labels"):
        sets_heard(sets_of(np.array([1.0])), np.array([-np.inf]))
