"""The loops of `phd.reweigh`, `particles.places` and `particles.k_means`, over particles × rows, candidates or centres."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from sonobench.types import Array, Ints

_A1, _A2 = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 2))
_W1, _W2 = (types.Array(types.float64, n, "C") for n in (1, 2))
_I1 = types.Array(types.int64, 1, "C")
_LLOYD = 100

#: e^−60 of a sum's largest term changes no bit of it, were there a billion of such terms
_FAINT = -60.0


@njit(types.void(_W2, _A1), cache=True)
def log_share(joint: Array, log_clutter: Array) -> None:
    """Turn log joint weights (N, m) into log shares of each row's evidence, in place: joint − log(kappa + Σ exp(joint))."""
    N, m = joint.shape
    top, total = log_clutter.copy(), np.zeros(m)
    for j in range(N):
        for z in range(m):
            top[z] = max(top[z], joint[j, z])
    for j in range(N):
        for z in range(m):
            below = joint[j, z] - top[z]
            if below > _FAINT:  # not where both are −inf
                total[z] += math.exp(below)
    for z in range(m):
        if top[z] > -np.inf:
            top[z] += math.log(total[z] + math.exp(log_clutter[z] - top[z]))
        else:
            top[z] = 0.0
    for j in range(N):
        for z in range(m):
            joint[j, z] -= top[z]


@njit(types.void(_W1, _A2), cache=True)
def add_logs(log: Array, more: Array) -> None:
    """log (N,) becomes log(exp(log) + Σ exp(more)), more (N, m)."""
    N, m = more.shape
    for j in range(N):
        top = log[j]
        for z in range(m):
            top = max(top, more[j, z])
        if top == -np.inf:
            continue
        total = math.exp(log[j] - top)
        for z in range(m):
            if more[j, z] - top > _FAINT:
                total += math.exp(more[j, z] - top)
        log[j] = top + math.log(total)


@njit(types.void(_A2, _W1), cache=True)
def row_totals(log: Array, out: Array) -> None:
    """Add Σ exp(log) over the particles (N, m) to each row's number (m,)."""
    N, m = log.shape
    for j in range(N):
        for z in range(m):
            if log[j, z] > _FAINT:
                out[z] += math.exp(log[j, z])


@njit(types.void(_A2, _A1, _A2, types.float64, _W1), cache=True)
def masses(x: Array, w: Array, centres: Array, square: float, out: Array) -> None:
    """Weight (n,) of the particles x (N, k), w (N,) whose squared distance to each of the centres (k, n) is at most `square`."""
    out[:] = 0.0
    distance = np.empty(len(out))
    for j in range(len(x)):
        distance[:] = 0.0
        for k in range(x.shape[1]):
            for c in range(len(out)):
                distance[c] += (x[j, k] - centres[k, c]) ** 2
        for c in range(len(out)):
            out[c] += w[j] if distance[c] <= square else 0.0


@njit(cache=True)
def _lloyd(x: Array, w: Array, centre: Array, of: Ints) -> float:
    """Move the centres (n, k) to their clusters' means until no particle changes its cluster; the weighted sum of squares."""
    N, dims = x.shape
    n = len(centre)
    cost = 0.0
    for _ in range(_LLOYD):
        changed, cost = False, 0.0
        mass, total = np.zeros(n), np.zeros((n, dims))
        for j in range(N):
            least, own = np.inf, 0
            for c in range(n):
                square = 0.0
                for k in range(dims):
                    square += (x[j, k] - centre[c, k]) ** 2
                if square < least:
                    least, own = square, c
            changed |= own != of[j]
            of[j] = own
            cost += w[j] * least
            mass[own] += w[j]
            for k in range(dims):
                total[own, k] += w[j] * x[j, k]
        if not changed:
            break
        for c in range(n):
            if mass[c] > 0.0:
                for k in range(dims):
                    centre[c, k] = total[c, k] / mass[c]
    return cost


@njit(types.void(_A2, _A1, _W2, _I1), cache=True)
def k_means(x: Array, w: Array, draws: Array, best: Ints) -> None:
    """The cluster (N,) of each particle x (N, k) of weight (N,), from the starts that draws (starts, n) of uniform numbers choose."""
    N, dims = x.shape
    n = draws.shape[1]
    centre, of, near, least = np.empty((n, dims)), np.empty(N, np.int64), np.empty(N), np.inf
    for start in range(len(draws)):
        near[:] = 1.0  # the first seed is drawn by weight alone
        for c in range(n):
            total = 0.0
            for j in range(N):
                total += w[j] * near[j]
            left, pick = draws[start, c] * total, 0
            for j in range(N):
                if w[j] * near[j] > 0.0:
                    pick = j
                    left -= w[j] * near[j]
                    if left < 0.0:
                        break
            for k in range(dims):
                centre[c, k] = x[pick, k]
            for j in range(N):
                square = 0.0
                for k in range(dims):
                    square += (x[j, k] - centre[c, k]) ** 2
                near[j] = square if c == 0 else min(near[j], square)
        of[:] = -1
        cost = _lloyd(x, w, centre, of)
        if cost < least:
            least = cost
            best[:] = of
