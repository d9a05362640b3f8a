"""The loop of the Gibbs sampler in `filtering.glmb`. Signatures are explicit so that one compiled function takes writable and read-only arrays."""

from __future__ import annotations

import numpy as np
from numba import njit, types

from sonobench.types import Array, Ints

_A2 = types.Array(types.float64, 2, "C", readonly=True)
_N1, _N2 = (types.Array(types.int64, n, "C", readonly=True) for n in (1, 2))
_W1, _W2 = (types.Array(types.int64, n, "C") for n in (1, 2))


@njit(types.void(_A2, _N2, _N1, types.int64, _A2, _W1, _W2), cache=True)
def gibbs(weight: Array, of: Ints, sweeps: Ints, private: int, uniform: Array, parent: Ints, choice: Ints) -> None:
    """Fill parent (S,) and choice (S, L), −1 where of is, with the states of one chain of sweeps[h] steps for each row h of `of` (H, L).

    weight (T, c) of columns for tracks; columns from `private` on serve one track; uniform (S, L) numbers in [0, 1).
    """
    L, c = of.shape[1], weight.shape[1]
    taken, edges = np.zeros(c, np.bool_), np.empty(c)
    s = 0
    for h in range(len(of)):
        if sweeps[h] == 0:
            continue
        taken[:] = False
        for step in range(sweeps[h]):
            parent[s] = h
            for i in range(L):
                t = of[h, i]
                if t < 0:
                    choice[s, i] = -1
                    continue
                if step > 0:
                    taken[choice[s - 1, i]] = False
                total, best = 0.0, 0
                for j in range(c):
                    if not (j >= private and taken[j]):
                        total += weight[t, j]
                        if weight[t, j] > weight[t, best]:
                            best = j
                    edges[j] = total
                j = best  # each track's best that is left begins a chain
                if step > 0 and total > 0:
                    at, j = uniform[s, i] * total, 0
                    while j < c - 1 and edges[j] <= at:
                        j += 1
                choice[s, i] = j
                taken[j] = True
            s += 1
