"""The loops of `phd.reweigh` and `particles.balls`, over particles × rows and candidates × particles."""

from __future__ import annotations

import math

import numpy as np
from numba import njit, types

from sonobench.types import Array

_A1, _A2 = (types.Array(types.float64, n, "C", readonly=True) for n in (1, 2))
_W1, _W2 = (types.Array(types.float64, n, "C") for n in (1, 2))

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
