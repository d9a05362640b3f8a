"""Weighted particles as arrays, and the targets that they stand for."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import NamedTuple

import numpy as np

from sonobench.protocols import Mixture
from sonobench.types import Array, Bools, Ints

_CANDIDATES = 128
_SHIFTS = 3
_STARTS = 4


class Cloud(NamedTuple):
    """Particles of an intensity: log_w (N,), x (N, d), mode (N,), label (N,) of the target that each belongs to, or None."""

    log_w: Array
    x: Array
    mode: Ints
    label: Ints | None = None


@cache
def particle_kernels() -> ModuleType:
    """The compiled loops, imported at their first use: Numba alone takes a third of a second, and imports are watched in trials."""
    from sonobench.filtering import particle_kernels

    return particle_kernels


def empty_cloud(d: int, labelled: bool = False) -> Cloud:
    """No particles of dimension d."""
    return Cloud(np.zeros(0), np.zeros((0, d)), np.zeros(0, np.int64), np.zeros(0, np.int64) if labelled else None)


def join(*clouds: Cloud) -> Cloud:
    """The sum of intensities: all particles, in order; labels where all clouds have them."""
    label = None if any(c.label is None for c in clouds) else np.concatenate([np.asarray(c.label) for c in clouds])
    log_w, x, mode = (np.concatenate(parts) for parts in zip(*(c[:3] for c in clouds), strict=True))
    return Cloud(log_w, x, mode, label)


def gathered(x: Array, w: Array) -> tuple[Array, Array]:
    """Mean (d,) and covariance (d, d) of particles (n, d) of weights (n,) that do not sum to zero."""
    m, P = np.empty(x.shape[1]), np.empty((x.shape[1], x.shape[1]))
    particle_kernels().moments(np.ascontiguousarray(x, float), np.ascontiguousarray(w, float), m, P)
    return m, P


def balls(cloud: Cloud, columns: list[int], radius: float, weight: float, copies: bool) -> Mixture:
    """Targets as the balls, in the given columns, that hold more than `weight`, heaviest first (see `places`).

    What a ball holds is one target, with `copies` as many as its weight rounds to.
    """
    found: list[tuple[float, Array, Array]] = []
    w = np.exp(cloud.log_w)
    for inside in places(cloud.x[:, columns], w, radius, weight):
        mass = w[inside].sum()
        number = max(int(np.rint(mass)), 1) if copies else 1
        found += [(mass, *gathered(cloud.x[inside], w[inside]))] * number
    return _listed(found, cloud.x.shape[1])


def places(x: Array, w: Array, radius: float, weight: float) -> list[Bools]:
    """Which of the particles x (N, k), w (N,) lie (N,) in each of the balls that hold more than `weight`, heaviest first; no two share one.

    The best of a fixed number of candidate centres, spread over the weights, moves to its ball's mean a few times, and what
    the ball holds is taken away. The result depends on the particles only, no random number is drawn.
    """
    kernels, mass_at = particle_kernels(), np.empty(_CANDIDATES)
    x, w = np.ascontiguousarray(x), np.ascontiguousarray(w)
    found: list[Bools] = []
    while len(w) and w.sum() > weight:
        edges = np.cumsum(w)
        picks = np.searchsorted(edges, edges[-1] * (np.arange(_CANDIDATES) + 0.5) / _CANDIDATES)
        kernels.masses(x, w, np.ascontiguousarray(x[picks].T), float(radius) ** 2, mass_at)
        centre = x[picks[np.argmax(mass_at)]]
        for _ in range(_SHIFTS):
            inside = (np.sum((x - centre) ** 2, axis=1) <= radius**2) & (w > 0)
            centre = w[inside] @ x[inside] / w[inside].sum()
        if not w[inside].sum() > weight:
            break
        found.append(inside)
        w = np.where(inside, 0.0, w)
    return found


def clustered(rng: np.random.Generator, cloud: Cloud, columns: list[int]) -> Mixture:
    """Targets as the clusters of a k-means of the weighted particles in the given columns, as many as their weights round to."""
    w = np.exp(cloud.log_w)
    n = int(np.rint(w.sum()))
    if n == 0:
        return _listed([], cloud.x.shape[1])
    of = k_means(rng, cloud.x[:, columns], w, n)
    groups = [of == k for k in range(n) if w[of == k].sum() > 0]
    return _listed([(w[own].sum(), *gathered(cloud.x[own], w[own])) for own in groups], cloud.x.shape[1])


def k_means(rng: np.random.Generator, x: Array, w: Array, n: int) -> Ints:
    """The cluster (N,) out of n of each particle x (N, k) with weights (N,) above zero in all.

    Lloyd's iteration from the seeds of k-means++ (Arthur & Vassilvitskii 2007), the best of a few starts. Fewer than n different places leave clusters empty.
    """
    of = np.empty(len(x), np.int64)
    particle_kernels().k_means(np.ascontiguousarray(x), np.ascontiguousarray(w), rng.random((_STARTS, n)), of)
    return of


def shared(cloud: Cloud, shares: Array, weight: float) -> Mixture:
    """Targets as the rows of a scan whose shares (N, m) of the particles' weights sum to more than `weight`."""
    total = shares.sum(axis=0)
    order = [z for z in np.argsort(-total, kind="stable") if total[z] > weight]
    return _listed([(total[z], *gathered(cloud.x, shares[:, z])) for z in order], cloud.x.shape[1])


def labelled(cloud: Cloud, weight: float) -> tuple[Mixture, Ints]:
    """Targets as the labels, from 0 on, whose particles hold more than `weight`, oldest first; and these labels."""
    label, w = np.asarray(cloud.label), np.exp(cloud.log_w)
    total = np.bincount(label + 1, w)[1:]
    found = np.flatnonzero(total > weight)
    owns = [label == n for n in found]
    return _listed([(total[n], *gathered(cloud.x[own], w[own])) for n, own in zip(found, owns, strict=True)], cloud.x.shape[1]), found


def _listed(found: list[tuple[float, Array, Array]], d: int) -> Mixture:
    n = len(found)
    return Mixture(
        np.array([f[0] for f in found]),
        np.array([f[1] for f in found]).reshape(n, d),
        np.array([f[2] for f in found]).reshape(n, d, d),
        np.zeros(n, np.int64),
    )
