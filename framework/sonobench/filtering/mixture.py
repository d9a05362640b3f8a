"""Gaussian mixtures as arrays of components: predict, prune, merge, cap, extract.

Source: Vo & Ma 2006, "The Gaussian mixture probability hypothesis density filter", tables I to III.
"""

from __future__ import annotations

from functools import cache
from types import ModuleType
from typing import Any, cast

import numpy as np

from sonobench.filtering.gaussian import definite
from sonobench.protocols import Mixture, Motion
from sonobench.types import Array, Bools, Ints, Space


@cache
def kernels() -> ModuleType:
    """The compiled loops, imported at their first use: Numba alone takes a third of a second, and imports are watched in trials."""
    from sonobench.filtering import mixture_kernels

    return mixture_kernels


def empty(d: int) -> Mixture:
    """No components of dimension d."""
    return Mixture(np.zeros(0), np.zeros((0, d)), np.zeros((0, d, d)), np.zeros(0, np.int64))


def union(*mixtures: Mixture) -> Mixture:
    """The sum of intensities: all components, in order."""
    return Mixture(
        np.concatenate([a.w for a in mixtures]),
        np.concatenate([a.m for a in mixtures]),
        np.concatenate([a.P for a in mixtures]),
        np.concatenate([a.mode for a in mixtures]),
    )


def take(mixture: Mixture, which: Ints | Bools) -> Mixture:
    """The components of an index or mask."""
    return Mixture(mixture.w[which], mixture.m[which], mixture.P[which], mixture.mode[which])


def predict(mixture: Mixture, motion: Motion, p_s: float, dt_s: float) -> Mixture:
    """Survivors after dt_s: weights times p_s, moments through the motion model (Vo & Ma 2006, eq. 24).

    Under a motion of several modes each component becomes one of each mode that it may be in by then (Pasha, Vo, Tuan & Ma 2009).
    """
    if len(mixture.w) == 0:
        return mixture
    if motion.n_modes == 1:
        m, P = motion.moments(mixture.m, mixture.P, mixture.mode, dt_s)
        return Mixture(mixture.w * p_s, m, P, mixture.mode)
    probability, m, P = cast(Any, motion).branches(mixture.m, mixture.P, mixture.mode, dt_s)
    w, d = (mixture.w * p_s)[:, None] * probability, m.shape[-1]
    mode = np.broadcast_to(np.arange(motion.n_modes, dtype=np.int64), w.shape)
    return take(Mixture(w.ravel(), m.reshape(-1, d), P.reshape(-1, d, d), mode.ravel()), w.ravel() > 0)


def any_mode(mixture: Mixture) -> Mixture:
    """The mixture with all components in one mode, so that `merge` joins what differs in its mode only."""
    return mixture._replace(mode=np.zeros_like(mixture.mode))


def prune(mixture: Mixture, weight: float) -> Mixture:
    """The components above `weight`; the mass of the others is lost (Vo & Ma 2006, table II)."""
    return take(mixture, mixture.w > weight)


def merge(mixture: Mixture, distance: float, space: Space) -> Mixture:
    """Join components to heavier ones of the same mode within a Mahalanobis `distance`, heaviest first, moments kept.

    The distance of candidate i to the heaviest, j, is √((mᵢ − mⱼ)ᵀ Pᵢ⁻¹ (mᵢ − mⱼ)) in the candidate's own covariance
    (Vo & Ma 2006, table II, whose U is its square). Equal weights keep their order. The sum of weights does not change.
    Differences of periodic coordinates are the space's, and their mean is taken about the heaviest of the joined.
    """
    n = len(mixture.w)
    if n < 2:
        return mixture
    w, m, P, mode = take(mixture, _falling(mixture.w))
    label, periods = np.empty(n, np.int64), np.array(space.periods)
    groups = kernels().group(m, P, definite(P), mode, periods, float(distance) ** 2, label)
    if groups < 0:
        raise ValueError("a covariance of the mixture is not positive definite, so that nothing has a Mahalanobis distance")
    first = np.searchsorted(np.maximum.accumulate(label), np.arange(groups))  # groups are numbered as they first occur
    weight, mean, cov = kernels().joined(w, m, P, periods, label, groups)
    return Mixture(weight, mean, cov, mode[first])


def _falling(w: Array) -> Ints:
    """Order by falling weight; equal weights keep theirs."""
    return np.argsort(-w, kind="stable").astype(np.int64)


def cap(mixture: Mixture, most: int) -> Mixture:
    """At most `most` components, the heaviest; equal weights keep their order."""
    if len(mixture.w) <= most:
        return mixture
    return take(mixture, np.sort(_falling(mixture.w)[:most]))


def extract(mixture: Mixture, weight: float, copies: bool) -> Mixture:
    """The components above `weight`, heaviest first; with `copies`, each as often as its weight rounds to (Vo & Ma 2006, table III)."""
    order = _falling(mixture.w)
    order = order[mixture.w[order] > weight]
    if copies:
        order = np.repeat(order, np.maximum(np.rint(mixture.w[order]).astype(np.int64), 1))
    return take(mixture, order)
