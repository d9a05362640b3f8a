"""Resampling of weighted particles.

Source: Kitagawa 1996, "Monte Carlo filter and smoother for non-Gaussian nonlinear state space models" (stratified and systematic); Liu & Chen
1998, "Sequential Monte Carlo methods for dynamic systems" (residual). Compared in Douc, Cappé & Moulines 2005.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from sonobench.filtering.particles import particle_kernels
from sonobench.types import Array, Ints

Resampling = Literal["systematic", "stratified", "residual"]


def systematic(rng: np.random.Generator, w: Array, n: int) -> Ints:
    """Indices (n,) drawn with one uniform number: particle i comes ⌊n wᵢ⌋ or ⌈n wᵢ⌉ times (w need not sum to 1).

    Raises:
        ValueError: the weights sum to zero or are not finite.
    """
    return _rising(_edges(w), (np.arange(n) + rng.random()) / n)


def stratified(rng: np.random.Generator, w: Array, n: int) -> Ints:
    """Indices (n,) drawn with a uniform number in each of n equal strata.

    Raises:
        ValueError: the weights sum to zero or are not finite.
    """
    return _rising(_edges(w), (np.arange(n) + rng.random(n)) / n)


def residual(rng: np.random.Generator, w: Array, n: int) -> Ints:
    """Indices (n,): particle i comes ⌊n wᵢ⌋ times for certain, the rest is drawn independently from what rounding cut off.

    Raises:
        ValueError: the weights sum to zero or are not finite.
    """
    expected = np.maximum(n * np.diff(_edges(w), prepend=0.0), 0.0)  # the last edge is set to 1, which may lie below the sum before it
    certain = np.floor(expected)
    rest = n - int(certain.sum())
    times = certain.astype(np.int64)
    if rest:
        times += np.bincount(_at(_edges(expected - certain), rng.random(rest)), minlength=len(w))
    return np.repeat(np.arange(len(w)), times)


#: by the name that parameters use
RESAMPLERS: Mapping[Resampling, Callable[[np.random.Generator, Array, int], Ints]] = MappingProxyType(
    {"systematic": systematic, "stratified": stratified, "residual": residual}
)


def _edges(w: Array) -> Array:
    """Upper edges of the particles' shares of [0, 1]."""
    total = np.sum(w)
    if not (np.isfinite(total) and total > 0):
        raise ValueError(f"weights that sum to {total} cannot be resampled")
    edges = np.cumsum(w) / total
    edges[-1] = 1.0
    return edges


def _rising(edges: Array, at: Array) -> Ints:
    """`_at` of rising numbers, in one walk."""
    chosen = np.empty(len(at), np.int64)
    particle_kernels().at_edges(edges, at, chosen)
    return chosen


def _at(edges: Array, at: Array) -> Ints:
    return np.searchsorted(edges, at, side="right").astype(np.int64)
