"""The loops of `phd.correct` and `mixture.merge`: on a dozen components NumPy's calls cost ten times the arithmetic.

Signatures are explicit so that writable and read-only arrays share one compiled function. Arrays are in C order.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from sonobench.types import Array, Ints

_A1, _A2, _A3, _A4 = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 2, 3, 4))
_N = types.Array(types.int64, 1, "C", readonly=True)
_W1, _W2, _W3 = (types.Array(types.float64, n, "C") for n in (1, 2, 3))
_WN = types.Array(types.int64, 1, "C")


@njit(types.boolean(_A2, _W2), cache=True)
def _factor(S: Array, L: Array) -> bool:
    """The Cholesky factor of S's lower half into L's; False where there is none."""
    n = len(S)
    for i in range(n):
        for j in range(i + 1):
            total = S[i, j]
            for k in range(j):
                total -= L[i, k] * L[j, k]
            if i > j:
                L[i, j] = total / L[j, j]
            elif total > 0:
                L[i, i] = math.sqrt(total)
            else:
                return False
    return True


@njit(types.float64(_A2, _A1, _W1), cache=True)
def _whiten(L: Array, b: Array, out: Array) -> float:
    """out = L⁻¹ b; returns its squared length."""
    square = 0.0
    for i in range(len(b)):
        total = b[i]
        for k in range(i):
            total -= L[i, k] * out[k]
        out[i] = total / L[i, i]
        square += out[i] * out[i]
    return square


@njit(types.boolean(_A4, types.Array(types.float64, 4, "C"), _W2), cache=True)
def whiteners(S: Array, W: Array, log_norm: Array) -> bool:
    """Inverse Cholesky factors W (A, B, dz, dz), zero on entry, of S, and log N(0; 0, S) (A, B); False where S is singular."""
    A, B, dz = S.shape[:3]
    L = np.empty((dz, dz))  # W is its inverse
    for a in range(A):
        for b in range(B):
            if not _factor(S[a, b], L):
                return False
            log_norm[a, b] = -0.5 * dz * math.log(2 * math.pi)
            for i in range(dz):
                log_norm[a, b] -= math.log(L[i, i])
                W[a, b, i, i] = 1.0 / L[i, i]
                for r in range(i + 1, dz):
                    total = 0.0
                    for k in range(i, r):
                        total -= L[r, k] * W[a, b, k, i]
                    W[a, b, r, i] = total / L[r, r]
    return True


@njit(types.boolean(_A3, _A4, _W2), cache=True)
def log_densities(residual: Array, S: Array, out: Array) -> bool:
    """log N(residual (J, m, dz); 0, S (J or 1, m or 1, dz, dz)) into out (J, m); False where a covariance is singular."""
    J, m, dz = residual.shape
    A, B = S.shape[:2]
    W, log_norm = np.zeros(S.shape), np.empty((A, B))
    if not whiteners(S, W, log_norm):
        return False
    for j in range(J):
        a = min(j, A - 1)
        for z in range(m):
            b = min(z, B - 1)
            square = 0.0
            for i in range(dz):
                white = 0.0
                for k in range(i + 1):
                    white += W[a, b, i, k] * residual[j, z, k]
                square += white * white
            out[j, z] = log_norm[a, b] - 0.5 * square
    return True


@njit(types.void(_W2, _A1), cache=True)
def share(joint: Array, log_clutter: Array) -> None:
    """Turn log joint weights (J, m) into shares of each row's evidence, in place: exp(joint) / (kappa + Σ exp(joint))."""
    J, m = joint.shape
    for z in range(m):
        top = log_clutter[z]
        for j in range(J):
            top = max(top, joint[j, z])
        evidence = 0.0
        if top > -np.inf:
            total = math.exp(log_clutter[z] - top)
            for j in range(J):
                total += math.exp(joint[j, z] - top)
            evidence = top + math.log(total)
        for j in range(J):
            joint[j, z] = math.exp(joint[j, z] - evidence)


@njit(types.Tuple((_W1, _W2, _W3, _WN))(_A2, _A2, _A3, _A3, _A4, _A3, types.float64), cache=True)
def conditioned(w: Array, m: Array, P: Array, residual: Array, S: Array, cross: Array, above: float) -> tuple[Array, Array, Array, Ints]:
    """Means and covariances of the weights above `above`: m + K residual, P − K crossᵀ with K = cross S⁻¹.

    Args:
        w: (J, n) weights.
        m, P: (J, d), (J, d, d).
        residual, S, cross: (J, n, dz), (J, n or 1, dz, dz), (J, d, dz).

    Returns:
        Weights, means and covariances of those that stay, row after row of measurements, and the component that each is of.
    """
    J, n, dz = residual.shape
    d = m.shape[1]
    kept = 0
    for j in range(J):
        for z in range(n):
            kept += w[j, z] > above
    out_w, out_m, out_P, of = np.empty(kept), np.empty((kept, d)), np.empty((kept, d, d)), np.empty(kept, np.int64)
    L, white, half = np.empty((dz, dz)), np.empty(dz), np.empty((d, dz))  # half = cross L⁻ᵀ, so that K crossᵀ = half halfᵀ
    place = np.empty((J, n), np.int64)
    at = 0
    for z in range(n):
        for j in range(J):
            place[j, z] = at if w[j, z] > above else -1
            at += w[j, z] > above
    for j in range(J):
        known = -1  # the S that L and half are of
        for z in range(n):
            at = place[j, z]
            if at < 0:
                continue
            s = min(z, S.shape[1] - 1)
            if s != known:
                _factor(S[j, s], L)
                for i in range(d):
                    _whiten(L, cross[j, i], half[i])
                known = s
            _whiten(L, residual[j, z], white)
            out_w[at], of[at] = w[j, z], j
            for i in range(d):
                total = m[j, i]
                for k in range(dz):
                    total += half[i, k] * white[k]
                out_m[at, i] = total
                for c in range(i + 1):
                    total = 0.5 * (P[j, i, c] + P[j, c, i])
                    for k in range(dz):
                        total -= half[i, k] * half[c, k]
                    out_P[at, i, c] = out_P[at, c, i] = total
    return out_w, out_m, out_P, of


@njit(types.float64(types.float64, types.float64), cache=True)
def _wrapped(difference: float, period: float) -> float:
    """A difference in [−period/2, period/2), or as it is where the coordinate is a line (period 0)."""
    return difference - period * math.floor(difference / period + 0.5) if period > 0 else difference


@njit(types.int64(_A2, _A3, _A3, _N, _A1, types.float64, _WN), cache=True)
def group(m: Array, P: Array, metric: Array, mode: Ints, periods: Array, square: float, label: Ints) -> int:
    """Group components sorted by falling weight: each takes the free ones of its mode whose squared distance is at most `square`.

    Args:
        m, P, mode: (n, d), (n, d, d), (n,).
        metric: (n, d, d) covariances in which the distance to a candidate is measured.
        periods: (d,) of the coordinates, 0 of a line.
        square: squared Mahalanobis distance.
        label: (n,) receives the group's number.

    Returns:
        The number of groups, −1 where a metric is not positive definite.
    """
    n, d = m.shape
    factors, off, white = np.empty((n, d, d)), np.empty(d), np.empty(d)
    for i in range(n):
        if not _factor(metric[i], factors[i]):
            return -1
        label[i] = -1
    groups = 0
    for j in range(n):
        if label[j] >= 0:
            continue
        label[j] = groups
        for i in range(j + 1, n):
            if label[i] < 0 and mode[i] == mode[j]:
                for k in range(d):
                    off[k] = _wrapped(m[i, k] - m[j, k], periods[k])
                if _whiten(factors[i], off, white) <= square:
                    label[i] = groups
        groups += 1
    return groups


@njit(types.Tuple((_W1, _W2, _W3))(_A1, _A2, _A3, _A1, _N, types.int64), cache=True)
def joined(w: Array, m: Array, P: Array, periods: Array, label: Ints, groups: int) -> tuple[Array, Array, Array]:
    """Weight, mean and covariance of each group of components; a group without weight has the plain mean."""
    n, d = m.shape
    total, base = np.zeros(groups), np.zeros(groups)
    mean, cov, first = np.zeros((groups, d)), np.zeros((groups, d, d)), np.full(groups, -1)
    for i in range(n):
        total[label[i]] += w[i]
        if first[label[i]] < 0:
            first[label[i]] = i
    own = np.empty(n)
    for i in range(n):
        own[i] = w[i] if total[label[i]] > 0 else 1.0
        base[label[i]] += own[i]
    for i in range(n):
        own[i] /= base[label[i]]
        for a in range(d):  # a periodic coordinate counts as the turn of it that is nearest the first of its group
            lead = m[first[label[i]], a]
            mean[label[i], a] += own[i] * (lead + _wrapped(m[i, a] - lead, periods[a]) if periods[a] > 0 else m[i, a])
    off = np.empty(d)
    for i in range(n):
        g = label[i]
        for a in range(d):
            off[a] = _wrapped(m[i, a] - mean[g, a], periods[a])
        for a in range(d):
            for b in range(a + 1):
                spread = 0.5 * (P[i, a, b] + P[i, b, a]) + off[a] * off[b]
                cov[g, a, b] += own[i] * spread
    for g in range(groups):
        for a in range(d):
            for b in range(a):
                cov[g, b, a] = cov[g, a, b]
    return total, mean, cov
