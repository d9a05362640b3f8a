"""Marginal association probabilities beside the enumeration of every joint association."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sonobench.filtering.association import EXACT, marginals, passed


def enumerated(ratio):
    """(miss, hit) from the sum over all joint associations."""
    n, m = ratio.shape
    table = np.zeros((n, m + 1))
    for joint in itertools.product(range(m + 1), repeat=n):
        used = [j for j in joint if j]
        if len(set(used)) == len(used):
            table[range(n), joint] += np.prod([ratio[i, j - 1] for i, j in enumerate(joint) if j])
    table /= table.sum(axis=1, keepdims=True)
    return table[:, 0], table[:, 1:]


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 4), st.integers(1, 4), st.integers(0, 10_000))
def test_few_rows_are_summed_exactly(n, m, seed):
    ratio = np.exp(np.random.default_rng(seed).uniform(-8, 8, (n, m)))
    for got, want in zip(marginals(ratio), enumerated(ratio), strict=True):
        np.testing.assert_allclose(got, want, atol=1e-8)


@pytest.mark.parametrize("ratio", [[[0.0, 3.0, 0.5]], [[5.0, 2.0, 0.0], [0.0, 0.3, 40.0], [0.0, 0.0, 7.0]]])
def test_messages_are_exact_without_loops(ratio):
    miss, hit = enumerated(np.array(ratio))
    np.testing.assert_allclose(passed(np.array(ratio)), np.column_stack([miss, hit]), atol=1e-7)


@given(st.integers(0, 10_000))
def test_many_rows_of_which_few_matter_to_each_track_are_near_the_sum(seed):
    rng, rows = np.random.default_rng(seed), EXACT + 2
    ratio = np.exp(rng.uniform(-3, 3, (3, rows))) * (rng.random((3, rows)) < 0.4) + 1e-8
    many, few = marginals(ratio)[1], marginals(ratio[:, :EXACT])[1]
    assert many.shape == (3, rows)
    np.testing.assert_allclose(marginals(ratio)[0] + many.sum(axis=1), 1.0, atol=1e-12)
    np.testing.assert_allclose(few, passed(ratio[:, :EXACT])[:, 1:], atol=0.2)


def test_rows_that_are_nobodys_change_nothing():
    ratio = np.array([[2.0, 5.0], [1.0, 8.0]])
    miss, hit = marginals(np.column_stack([np.full((2, 40), 1e-12), ratio]))
    np.testing.assert_allclose(np.column_stack([miss, hit[:, 40:]]), np.column_stack(marginals(ratio)), atol=1e-15)
    assert not hit[:, :40].any()


def test_two_certain_tracks_do_not_share_a_row():
    miss, hit = marginals(np.array([[1e15, 1e3], [1e15, 1e12]]))
    np.testing.assert_allclose(hit, [[1, 0], [0, 1]], atol=1e-6)
    np.testing.assert_allclose(miss, 0, atol=1e-6)


@pytest.mark.parametrize("shape", [(0, 3), (2, 0)])
def test_without_tracks_or_rows_all_are_missed(shape):
    miss, hit = marginals(np.zeros(shape))
    np.testing.assert_array_equal(miss, np.ones(shape[0]))
    assert hit.shape == shape
