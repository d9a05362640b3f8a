"""The loops of `phd.reweigh`, `particles` and `resampling`, over particles × rows, candidates or centres."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from sonobench.filtering.mixture_kernels import whiteners
from sonobench.types import Array, Ints

_A1, _A2, _A3, _A4 = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 2, 3, 4))
_W1, _W2 = (types.Array(types.float64, n, "C") for n in (1, 2))
_I1 = types.Array(types.int64, 1, "C")
_LLOYD = 100

#: e^−60 of a sum's largest term changes no bit of it, were there a billion of such terms
_FAINT = -60.0

#: sums above this lack nothing by terms below e^_FAINT, were there a hundred of them
_PLAIN = 1e-8


@njit(types.boolean(_A3, _A4, _W2), cache=True)
def along(residual: Array, S: Array, out: Array) -> bool:
    """log N(residual (m, dz, N); 0, S (1, m or 1, dz, dz)) into out (m, N), the particles last; False where a covariance is singular."""
    m, dz, N = residual.shape
    W, log_norm = np.zeros(S.shape), np.empty(S.shape[:2])
    if not whiteners(S, W, log_norm):
        return False
    white = np.empty(N)
    for z in range(m):
        b, row = min(z, S.shape[1] - 1), out[z]
        row[:] = log_norm[0, b]
        for i in range(dz):
            white[:] = 0.0
            for k in range(i + 1):
                factor, component = W[0, b, i, k], residual[z, k]
                for j in range(N):
                    white[j] += factor * component[j]
            for j in range(N):
                row[j] -= 0.5 * white[j] * white[j]
    return True


@njit(types.void(_W2, _A1, _A1, _W2), cache=True)
def log_share(log: Array, log_w: Array, log_clutter: Array, share: Array) -> None:
    """Turn log likelihoods (m, N) into log shares of each row's evidence, in place: log_w + log − log(kappa + Σ exp(log_w + log)).

    Args:
        log: (m, N), the particles last.
        log_w: (N,) log weights times p_D.
        log_clutter: (m,) log kappa.
        share: (m, N) receives their exponentials, 0 where these are faint beside the row's largest.
    """
    m, N = log.shape
    for z in range(m):
        row, part, top = log[z], share[z], log_clutter[z]
        part[:] = 0.0
        for j in range(N):
            row[j] += log_w[j]
            top = max(top, row[j])
        if top == -np.inf:
            continue
        total = math.exp(log_clutter[z] - top)
        for j in range(N):
            if row[j] - top > _FAINT:
                part[j] = math.exp(row[j] - top)
                total += part[j]
        log_evidence, scale = top + math.log(total), 1.0 / total
        for j in range(N):
            row[j] -= log_evidence
            part[j] *= scale


@njit(types.void(_W1, _A2, _A1), cache=True)
def add_logs(log: Array, more: Array, plain: Array) -> None:
    """log (N,) becomes log(exp(log) + Σ exp(more)), more (m, N), of which `plain` (N,) sums the exponentials that are not faint."""
    m, N = more.shape
    for j in range(N):
        total = math.exp(log[j]) + plain[j]
        if _PLAIN < total < np.inf:
            log[j] = math.log(total)
            continue
        top = log[j]
        for z in range(m):
            top = max(top, more[z, j])
        if top == -np.inf:
            continue
        total = math.exp(log[j] - top)
        for z in range(m):
            if more[z, j] - top > _FAINT:
                total += math.exp(more[z, j] - top)
        log[j] = top + math.log(total)


@njit(types.void(_A2, _A1, _W1, _W2), cache=True)
def moments(x: Array, w: Array, mean: Array, cov: Array) -> None:
    """Mean (d,) and covariance (d, d) of particles (N, d) of weights (N,) that do not sum to zero."""
    N, d = x.shape
    total, off = 0.0, np.empty(d)
    mean[:], cov[:] = 0.0, 0.0
    for j in range(N):
        if w[j] > 0.0:
            total += w[j]
            for i in range(d):
                mean[i] += w[j] * x[j, i]
    for i in range(d):
        mean[i] /= total
    for j in range(N):
        if w[j] > 0.0:
            share = w[j] / total
            for i in range(d):
                off[i] = x[j, i] - mean[i]
                for k in range(i + 1):
                    cov[i, k] += share * off[i] * off[k]
    for i in range(d):
        for k in range(i):
            cov[k, i] = cov[i, k]


@njit(types.void(_A1, _A1, _I1), cache=True)
def at_edges(edges: Array, at: Array, out: Ints) -> None:
    """Which edge (N,) is the first above each of the rising numbers `at` (n,); the last one where none is."""
    j, last = 0, len(edges) - 1
    for k in range(len(at)):
        while j < last and edges[j] <= at[k]:
            j += 1
        out[k] = j


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
