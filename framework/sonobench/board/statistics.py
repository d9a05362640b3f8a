"""Intervals, ranks and paired comparisons of a matrix of unit values (n units, K pipelines).

A unit is what was drawn independently: a scene, or within one scene a repetition. All functions are pure; the
resamples come from a fixed seed, so that a board is a function of its scores, and are shared by all pipelines, so that
differences stay paired.

Sources: bootstrap-t: Efron & Tibshirani 1993, ch. 12.5. Step-down: Holm 1979. Letters: Piepho 2004 (insert and absorb).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sonobench.types import Array, Bools, Floats, Ints

#: units below which neither the bootstrap nor an exact signed test (2 / 2^n < .05) says anything at 5 %
MIN_UNITS = 6
LEVEL = 0.95
_RESAMPLES = 10_000
_EXACT = 14  # 2^13 sign patterns; beyond, as many random ones as below
_FLIPS = 20_000
_SEED = 2008


class Interval(NamedTuple):
    """A 95 % interval; `method` is "bootstrap-t", "t", or "" where one unit gives none."""

    low: float
    high: float
    method: str


def resamples(n: int) -> Floats:
    """(B, n) how often each unit is drawn in each bootstrap resample; the same for the same n."""
    return np.random.default_rng(_SEED).multinomial(n, np.full(n, 1 / n), size=_RESAMPLES).astype(float)


def interval(values: Array, counts: Floats | None = None) -> Interval:
    """95 % interval of the mean of (n,) unit values.

    Bootstrap-t from MIN_UNITS on; Student's t below, and where more than one in 200 resamples drew units without any
    spread, which leaves the studentised mean undefined.
    """
    n = len(values)
    if n < 2:
        return Interval(math.nan, math.nan, "")
    mean = float(values.mean())
    centred = values - mean
    error = float(np.sqrt(centred @ centred / (n * (n - 1))))
    if error <= 1e-12 * float(np.abs(values).max()):
        return Interval(mean, mean, "t" if n < MIN_UNITS else "bootstrap-t")
    if n >= MIN_UNITS:
        drawn = resamples(n) if counts is None else counts
        means = drawn @ centred / n
        variances = np.maximum(drawn @ centred**2 / n - means**2, 0.0) / (n - 1)
        spread = np.sqrt(variances) > 1e-6 * error
        if spread.mean() >= 0.995:
            t = means[spread] / np.sqrt(variances[spread])
            low, high = np.quantile(t, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            return Interval(mean - float(high) * error, mean - float(low) * error, "bootstrap-t")
    from scipy.special import stdtrit

    half = float(stdtrit(n - 1, (1 + LEVEL) / 2)) * error
    return Interval(mean - half, mean + half, "t")


def ranks(means: Floats) -> Ints:
    """Ranks (…, K) from 1, least first; equal means (to 12 digits) share the smaller rank."""
    from scipy.stats import rankdata

    scale = max(float(np.abs(means).max(initial=0.0)), 1e-300)
    return np.asarray(rankdata(np.round(means / scale, 12), method="min", axis=-1), np.int64)


def rank_intervals(values: Array, counts: Floats) -> tuple[Ints, Ints]:
    """Least and greatest rank (K,) of each column in the central 95 % of the resamples."""
    drawn = ranks(counts @ values / len(values))
    low, high = (1 - LEVEL) / 2, (1 + LEVEL) / 2
    return (
        np.quantile(drawn, low, axis=0, method="lower").astype(np.int64),
        np.quantile(drawn, high, axis=0, method="higher").astype(np.int64),
    )


def sign_flip(differences: Array) -> Array:
    """Two-sided p (M,) of paired differences (n, M) having mean 0, by flipping their signs.

    Exact over all 2^n patterns up to n = 14, else over 20 000 random ones and the observed one.
    """
    n, m = differences.shape
    if n == 0:
        return np.ones(m)
    if n <= _EXACT:  # a pattern and its opposite have the same |sum|: half of them are enough
        signs = np.array([(1, *rest) for rest in itertools.product((1, -1), repeat=n - 1)], float)
    else:
        signs = np.random.default_rng(_SEED).choice(np.array([1.0, -1.0]), size=(_FLIPS, n))
        signs = np.concatenate([np.ones((1, n)), signs])
    sums = np.abs(signs @ differences)
    slack = 1e-9 * np.abs(differences).sum(axis=0)
    return np.asarray((sums >= sums[0] - slack).mean(axis=0))


def holm(p: Array) -> Array:
    """Holm's step-down adjusted p (M,)."""
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


def units_needed(comparisons: int) -> int:
    """The least n at which 2 / 2^n can stay below 5 % after Holm over so many comparisons."""
    return max(MIN_UNITS, math.floor(math.log2(2 * max(comparisons, 1) / (1 - LEVEL)) + 1e-9) + 1)


def pairwise(values: Array) -> tuple[list[tuple[int, int]], Array]:
    """All pairs (i, j), i < j, of the columns (n, K), and their Holm-adjusted sign-flip p."""
    pairs = list(itertools.combinations(range(values.shape[1]), 2))
    if not pairs:
        return [], np.zeros(0)
    left, right = np.array(pairs).T
    return pairs, holm(sign_flip(values[:, left] - values[:, right]))


def letters(size: int, separated: Iterable[tuple[int, int]]) -> list[str]:
    """A compact letter display: two of `size` items share a letter exactly when they are not separated.

    Items are in ranking order; the first has "a".
    """
    groups = [frozenset(range(size))]
    for i, j in separated:
        split: list[frozenset[int]] = []
        for group in groups:
            split += [group - {i}, group - {j}] if i in group and j in group else [group]
        groups = [g for g in dict.fromkeys(split) if not any(g < other for other in split)]
    groups.sort(key=sorted)
    return ["".join(_letter(k) for k, group in enumerate(groups) if item in group) for item in range(size)]


def _letter(k: int) -> str:
    """a … z, then a1, b1, …"""
    return "abcdefghijklmnopqrstuvwxyz"[k % 26] + (str(k // 26) if k >= 26 else "")


def skewed(differences: Array) -> Bools:
    """Which columns (n, M) have a sample skewness beyond twice its standard error under normality."""
    n = len(differences)
    if n < MIN_UNITS:
        return np.zeros(differences.shape[1], bool)
    centred = differences - differences.mean(axis=0)
    second = (centred**2).mean(axis=0)
    unequal = second > 1e-20 * np.maximum((differences**2).mean(axis=0), 1e-300)
    skew = np.divide((centred**3).mean(axis=0), second**1.5, out=np.zeros_like(second), where=unequal & (second > 0))
    sample = skew * math.sqrt(n * (n - 1)) / (n - 2)
    return np.asarray(np.abs(sample) > 2 * math.sqrt(6 * n * (n - 1) / ((n - 2) * (n + 1) * (n + 3))))


def joined(names: Sequence[str]) -> str:
    """ "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
