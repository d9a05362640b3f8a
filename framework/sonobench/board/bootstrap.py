"""Resampling whole units: what the pooled statistic and its standard error come to in each resample.

The statistic is pooled again in every resample, and studentised by the error that the resample itself shows (from the
units' influences). Resamples come from a fixed seed, so that a board is a function of its scores, and are shared by all
pipelines, so that differences stay paired.

Source: Efron & Tibshirani 1993, ch. 12.5 (bootstrap-t) and 11.4 (influence).
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from sonobench.board.pooling import Units, influences
from sonobench.types import Floats

_RESAMPLES = 10_000
_AT_ONCE = 2_000_000  # counts held in memory
_WORK = 20_000_000  # drawn units in all, beyond which there are fewer resamples
_SEED = 2008


class Draws(NamedTuple):
    """Of M linear combinations of K pooled values, from n units.

    Attributes:
        n: units.
        value, error: (M,) as measured, and its standard error.
        values, errors: (B, M) of the resamples; none for n < 2.
    """

    n: int
    value: Floats
    error: Floats
    values: Floats
    errors: Floats


def bootstrap(units: Units, contrasts: Floats | None = None) -> Draws:
    """Resample units without missing values.

    Args:
        units: (n, K).
        contrasts: (K, M) weights of the pooled values; None: each by itself.
    """
    n, k = units.values.shape
    weights = np.eye(k) if contrasts is None else contrasts
    x = combined(units.values, weights)
    value = x.mean(axis=0) if n else np.full(x.shape[1], np.nan)
    if n < 2:
        nothing = np.zeros((0, x.shape[1]))
        return Draws(n, value, np.full(x.shape[1], np.nan), nothing, nothing)
    centred = x - value
    error = np.sqrt((centred**2).sum(axis=0) / (n * (n - 1)))
    if units.parts is None:
        drawn = [_of_means(counts, centred, value) for counts in _resamples(n)]
    else:
        work = max(1, units.parts.w[0].size, n * k)  # numbers a resample
        drawn = [_of_parts(c, units, weights) for counts in _resamples(n) for c in _split(counts, work)]
    values, errors = (np.concatenate(side) for side in zip(*drawn, strict=True))
    return Draws(n, value, error, values, errors)


def combined(values: Floats, contrasts: Floats) -> Floats:
    """(n, K) @ (K, M); what is only rounding is 0, so that pipelines with equal output are equal."""
    x = values @ contrasts
    return np.where(np.abs(x) <= 1e-12 * np.abs(values).max(initial=0.0), 0.0, x)


def _of_means(counts: Floats, centred: Floats, value: Floats) -> tuple[Floats, Floats]:
    n = len(centred)
    means = counts @ centred / n
    variances = np.maximum(counts @ centred**2 / n - means**2, 0.0) / (n - 1)
    return means + value, np.sqrt(variances)


def _of_parts(counts: Floats, units: Units, weights: Floats) -> tuple[Floats, Floats]:
    assert units.parts is not None  # for the type checker
    pooled, influence = influences(units.parts, counts)
    n = counts.shape[1]
    variances = np.einsum("bn,bnm->bm", counts, (influence @ weights) ** 2) * n / (n - 1)
    return pooled @ weights, np.sqrt(variances)


def _split(counts: Floats, work: int) -> Iterator[Floats]:
    step = max(1, _AT_ONCE // work)
    for start in range(0, len(counts), step):
        yield counts[start : start + step]


def _resamples(n: int) -> Iterator[Floats]:
    """Chunks (b, n) of how often each unit is drawn; the same for the same n."""
    if _RESAMPLES * n <= _AT_ONCE:
        yield _kept(n)
        return
    rng = np.random.default_rng(_SEED)
    left = max(1000, min(_RESAMPLES, _WORK // n))
    while left:
        size = min(left, max(1, _AT_ONCE // n))
        left -= size
        yield _drawn(rng, size, n)


@lru_cache(maxsize=8)
def _kept(n: int) -> Floats:
    counts = _drawn(np.random.default_rng(_SEED), _RESAMPLES, n)
    counts.flags.writeable = False
    return counts


def _drawn(rng: np.random.Generator, size: int, n: int) -> Floats:
    units = rng.integers(n, size=(size, n)) + np.arange(size)[:, None] * n
    return np.bincount(units.ravel(), minlength=size * n).reshape(size, n).astype(float)
