"""Intervals, ranks and paired comparisons of a matrix of unit values (n units, K pipelines).

A unit is what was drawn independently: a scenario, or within one scenario a repetition. All functions are pure; random
signs come from a fixed seed, so that a board is a function of its scores.

Sources: bootstrap-t: Efron & Tibshirani 1993, ch. 12.5. Step-down: Holm 1979. Letters: Piepho 2004 (insert and absorb).
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sonobench.board.bootstrap import Draws, combined
from sonobench.types import Bools, Floats, Ints

#: units below which neither the bootstrap nor an exact signed test (2 / 2^n < .05) says anything at 5 %
MIN_UNITS = 6
LEVEL = 0.95
_EXACT = 14  # 2^13 sign patterns; beyond, as many random ones as below
_FLIPS = 20_000
_AT_ONCE = 2_000_000  # signs held in memory
_SEED = 2008


class Interval(NamedTuple):
    """A 95 % interval; `method` is "bootstrap-t", "t", or "" where one unit gives none."""

    low: float
    high: float
    method: str


def intervals(draws: Draws) -> list[Interval]:
    """95 % intervals of M pooled values.

    Bootstrap-t from MIN_UNITS on; Student's t below, and where more than one in 200 resamples drew units without any
    spread, which leaves the studentised value undefined.
    """
    return [_interval(draws, m) for m in range(len(draws.value))]


def _interval(draws: Draws, m: int) -> Interval:
    n, value, error = draws.n, float(draws.value[m]), float(draws.error[m])
    if n < 2:
        return Interval(math.nan, math.nan, "")
    if error <= 1e-12 * abs(value) or error == 0:
        return Interval(value, value, "t" if n < MIN_UNITS else "bootstrap-t")
    if n >= MIN_UNITS:
        values, errors = draws.values[:, m], draws.errors[:, m]
        spread = errors > 1e-6 * error
        if spread.mean() >= 0.995:
            t = (values[spread] - value) / errors[spread]
            low, high = np.quantile(t, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
            return Interval(value - float(high) * error, value - float(low) * error, "bootstrap-t")
    from scipy.special import stdtrit

    half = float(stdtrit(n - 1, (1 + LEVEL) / 2)) * error
    return Interval(value - half, value + half, "t")


def ranks(means: Floats) -> Ints:
    """Ranks (…, K) from 1, least first; equal means (to 12 digits) share the smaller rank."""
    scale = max(float(np.abs(means).max(initial=0.0)), 1e-300)
    rounded = np.round(means / scale, 12)
    found = np.ones(rounded.shape, np.int64)
    for j in range(rounded.shape[-1]):
        found += rounded[..., j : j + 1] < rounded
    return found


def rank_intervals(values: Floats) -> tuple[Ints, Ints]:
    """Least and greatest rank (K,) of each column in the central 95 % of resampled values (B, K)."""
    drawn = np.sort(ranks(values), axis=0)
    outside = math.floor(len(drawn) * (1 - LEVEL) / 2)
    return drawn[outside], drawn[len(drawn) - 1 - outside]


def sign_flip(differences: Floats) -> Floats:
    """Two-sided p (M,) of paired differences (n, M) having mean 0, by flipping their signs.

    Exact over all 2^n patterns up to n = 14, else over 20 000 random ones and the observed one.
    """
    n, m = differences.shape
    if n == 0 or m == 0:
        return np.ones(m)
    slack = 1e-9 * np.abs(differences).sum(axis=0)
    least = np.abs(differences.sum(axis=0)) - slack
    reached, patterns = np.zeros(m), 0
    for signs in _patterns(n):
        reached += (np.abs(signs @ differences) >= least).sum(axis=0)
        patterns += len(signs)
    return reached / patterns


def _patterns(n: int) -> Iterator[Floats]:
    """Chunks (b, n) of signs, the observed ones among them; of a pattern and its opposite, whose |sum| is the same, one is enough."""
    if n <= _EXACT or n * _FLIPS <= _AT_ONCE:
        yield _kept_patterns(n)
        return
    yield np.ones((1, n))
    rng, left = np.random.default_rng(_SEED), _FLIPS
    while left:
        size = min(left, max(1, _AT_ONCE // n))
        left -= size
        yield _random_signs(rng, size, n)


@lru_cache(maxsize=8)
def _kept_patterns(n: int) -> Floats:
    if n <= _EXACT:
        signs = np.array([(1, *rest) for rest in itertools.product((1, -1), repeat=n - 1)], float)
    else:
        signs = np.concatenate([np.ones((1, n)), _random_signs(np.random.default_rng(_SEED), _FLIPS, n)])
    signs.flags.writeable = False
    return signs


def _random_signs(rng: np.random.Generator, size: int, n: int) -> Floats:
    return 2.0 * rng.integers(2, size=(size, n)) - 1.0


def holm(p: Floats) -> Floats:
    """Holm's step-down adjusted p (M,)."""
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate(p[order] * np.arange(len(p), 0, -1))
    adjusted = np.empty(len(p))
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted


def units_needed(comparisons: int) -> int:
    """The least n at which 2 / 2^n can stay below 5 % after Holm over so many comparisons."""
    return max(MIN_UNITS, math.floor(math.log2(2 * max(comparisons, 1) / (1 - LEVEL)) + 1e-9) + 1)


def pairwise(values: Floats) -> tuple[list[tuple[int, int]], Floats]:
    """All pairs (i, j), i < j, of the columns (n, K), and their Holm-adjusted sign-flip p."""
    pairs = list(itertools.combinations(range(values.shape[1]), 2))
    if not pairs:
        return [], np.zeros(0)
    eye = np.eye(values.shape[1])
    left, right = np.array(pairs).T
    return pairs, holm(sign_flip(combined(values, eye[:, left] - eye[:, right])))


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


def design_effect(differences: Floats, groups: Ints) -> Floats:
    """How many times larger (M,) the standard error is when whole groups of units (n,) are taken as drawn, not single units.

    1 where there are fewer than three groups, no group of several units, or no spread.
    """
    n, m = differences.shape
    labels, group = np.unique(groups, return_inverse=True)
    count = len(labels)
    if count < 3 or count == n:
        return np.ones(m)
    centred = differences - differences.mean(axis=0)
    sums = np.zeros((count, m))
    np.add.at(sums, group, centred)
    single = (centred**2).sum(axis=0) / (n - 1)
    grouped = (sums**2).sum(axis=0) / n * count / (count - 1)
    return np.sqrt(np.divide(grouped, single, out=np.ones(m), where=single > 1e-20 * (differences**2).mean(axis=0)))


def skewed(differences: Floats) -> Bools:
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
