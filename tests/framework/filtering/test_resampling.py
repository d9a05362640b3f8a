"""Each way of resampling is unbiased, and as certain as it claims."""

import numpy as np
import pytest

from sonobench.filtering.resampling import RESAMPLERS

W = np.array([0.0, 0.05, 0.5, 1.2, 0.25, 0.0])


def counts(name, n=20, draws=4000):
    rng = np.random.default_rng(0)
    return np.array([np.bincount(RESAMPLERS[name](rng, W, n), minlength=len(W)) for _ in range(draws)])


@pytest.mark.parametrize("name", RESAMPLERS)
def test_copies_are_the_weights_on_average(name):
    got, expected = counts(name), 20 * W / W.sum()
    assert (got.sum(axis=1) == 20).all()
    np.testing.assert_allclose(got.mean(axis=0), expected, atol=4 * max(got.std(axis=0)) / 4000**0.5 + 1e-9)


@pytest.mark.parametrize(("name", "below", "above"), [("systematic", 1, 1), ("stratified", 2, 2), ("residual", 1, 20)])
def test_copies_stray_no_farther_than_the_rule_allows(name, below, above):
    got, expected = counts(name), 20 * W / W.sum()
    assert (got > expected - below).all()
    assert (got < expected + above).all()
    assert got.std(axis=0).max() > 0.1


@pytest.mark.parametrize("name", RESAMPLERS)
@pytest.mark.parametrize("w", [np.zeros(3), np.array([1.0, np.nan]), np.array([np.inf, 1.0])])
def test_weights_of_no_sum_are_refused(name, w):
    with pytest.raises(ValueError, match="cannot be resampled"):
        RESAMPLERS[name](np.random.default_rng(0), w, 5)


def test_whole_expectations_are_met_exactly_by_residual_resampling():
    chosen = RESAMPLERS["residual"](np.random.default_rng(0), np.array([1.0, 2.0, 1.0]), 8)
    np.testing.assert_array_equal(np.bincount(chosen), [2, 4, 2])


def test_weights_whose_running_sum_rounds_above_their_total_are_resampled():
    rng, over = np.random.default_rng(3), 0
    for _ in range(400):
        w = np.append(rng.random(299) ** 20, 0.0)
        over += np.cumsum(w)[-2] / np.sum(w) > 1.0
        assert len(RESAMPLERS["residual"](rng, w, 300)) == 300
    assert over > 0
