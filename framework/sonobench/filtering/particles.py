"""Weighted particles as arrays, and the targets that they stand for."""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import NamedTuple

import numpy as np

from sonobench.protocols import Mixture
from sonobench.types import Array, Ints

_CANDIDATES = 128
_SHIFTS = 3


class Cloud(NamedTuple):
    """Particles of an intensity: log_w (N,), x (N, d), mode (N,)."""

    log_w: Array
    x: Array
    mode: Ints


@cache
def particle_kernels() -> ModuleType:
    """The compiled loops, imported at their first use: Numba alone takes a third of a second, and imports are watched in trials."""
    from sonobench.filtering import particle_kernels

    return particle_kernels


def empty_cloud(d: int) -> Cloud:
    """No particles of dimension d."""
    return Cloud(np.zeros(0), np.zeros((0, d)), np.zeros(0, np.int64))


def join(*clouds: Cloud) -> Cloud:
    """The sum of intensities: all particles, in order."""
    return Cloud(*(np.concatenate(parts) for parts in zip(*clouds, strict=True)))


def gathered(x: Array, w: Array) -> tuple[Array, Array]:
    """Mean (d,) and covariance (d, d) of particles (n, d) of weights (n,) that do not sum to zero."""
    share = w / w.sum()
    m = share @ x
    off = x - m
    return m, (off * share[:, None]).T @ off


def balls(cloud: Cloud, columns: list[int], radius: float, weight: float, copies: bool) -> Mixture:
    """Targets as the balls, in the given columns, that hold more than `weight`, heaviest first.

    The best of a fixed number of candidate centres, spread over the weights, moves to its ball's mean a few times; what the
    ball holds is one target (with `copies`, as many as its weight rounds to) and is taken away. The result depends on the
    particles only, no random number is drawn.
    """
    kernels, mass_at = particle_kernels(), np.empty(_CANDIDATES)
    x, w = np.ascontiguousarray(cloud.x[:, columns]), np.exp(cloud.log_w)
    found: list[tuple[float, Array, Array]] = []
    while len(w) and w.sum() > weight:
        edges = np.cumsum(w)
        picks = np.searchsorted(edges, edges[-1] * (np.arange(_CANDIDATES) + 0.5) / _CANDIDATES)
        kernels.masses(x, w, np.ascontiguousarray(x[picks].T), float(radius) ** 2, mass_at)
        centre = x[picks[np.argmax(mass_at)]]
        for _ in range(_SHIFTS):
            inside = np.sum((x - centre) ** 2, axis=1) <= radius**2
            centre = w[inside] @ x[inside] / w[inside].sum()
        mass = w[inside].sum()
        if not mass > weight:
            break
        number = max(int(np.rint(mass)), 1) if copies else 1
        found += [(mass, *gathered(cloud.x[inside], w[inside]))] * number
        w = np.where(inside, 0.0, w)
    return _listed(found, cloud.x.shape[1])


def shared(cloud: Cloud, log_shares: Array, weight: float) -> Mixture:
    """Targets as the rows of a scan whose shares (N, m) of the particles' weights sum to more than `weight`."""
    shares = np.exp(log_shares)
    total = shares.sum(axis=0)
    order = [z for z in np.argsort(-total, kind="stable") if total[z] > weight]
    return _listed([(total[z], *gathered(cloud.x, shares[:, z])) for z in order], cloud.x.shape[1])


def _listed(found: list[tuple[float, Array, Array]], d: int) -> Mixture:
    n = len(found)
    return Mixture(
        np.array([f[0] for f in found]),
        np.array([f[1] for f in found]).reshape(n, d),
        np.array([f[2] for f in found]).reshape(n, d, d),
        np.zeros(n, np.int64),
    )
