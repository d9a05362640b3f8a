"""Which measurement is whose: marginal probabilities of joint associations.

A joint association gives every measurement to one track or to clutter, and every track one measurement or none; its
probability is proportional to the product of its tracks' ratios. Up to `EXACT` measurements that matter, all of them are
summed, track by track over the sets of measurements that earlier tracks took; beyond, messages are passed.
Source: Bar-Shalom, Li & Kirubarajan 2001, section 6.4 (joint probabilistic data association), for what is summed;
Williams & Lau 2014, "Approximate evaluation of marginal association probabilities with belief propagation", for the
messages, which always settle, exact where tracks and measurements form no loop.
"""

from __future__ import annotations

import numpy as np

from sonobench.types import Array

EXACT = 10  #: measurements up to which the sum is exact; its cost doubles with each
_SETTLED = 1e-9
_NEGLIGIBLE = 1e-9  # a ratio below is taken as 0


def marginals(ratio: Array) -> tuple[Array, Array]:
    """Marginal probabilities that a track has no measurement (n,) and that it has each one (n, m).

    Args:
        ratio: (n, m) likelihood that measurement j is track i's over that of j being clutter and i having none; finite.
    """
    n, m = ratio.shape
    matter = np.flatnonzero(ratio.max(axis=0, initial=0.0) > _NEGLIGIBLE)
    table = (summed if len(matter) <= EXACT else passed)(ratio[:, matter])
    hit = np.zeros((n, m))
    hit[:, matter] = table[:, 1:]
    return table[:, 0], hit


def summed(ratio: Array) -> Array:
    """(n, 1 + m) exactly: none, then each of few measurements; O(n m 2^m)."""
    n, m = ratio.shape
    sets = np.arange(2**m)
    without = [sets[(sets >> j) & 1 == 0] for j in range(m)]
    taken = np.zeros((n + 1, 2**m))  # [i, s]: weight of the first i tracks taking exactly the set s
    taken[0, 0] = 1.0
    for i in range(n):
        taken[i + 1] = taken[i]
        for j in range(m):
            taken[i + 1, without[j] | 1 << j] += ratio[i, j] * taken[i, without[j]]
        taken[i + 1] /= taken[i + 1].sum()
    table = np.empty((n, 1 + m))
    rest = np.ones(2**m)  # [s]: weight of the tracks after i taking any of what s leaves
    for i in reversed(range(n)):
        table[i, 0] = taken[i] @ rest
        before = rest.copy()
        for j in range(m):
            later = ratio[i, j] * rest[without[j] | 1 << j]
            table[i, 1 + j] = taken[i, without[j]] @ later
            before[without[j]] += later
        rest = before / before.max()
    return table / table.sum(axis=1, keepdims=True)


def passed(ratio: Array, iterations: int = 500) -> Array:
    """(n, 1 + m) by belief propagation, for any number of measurements; where tracks contest, within some tenths."""
    n, m = ratio.shape
    others, rivals = 1.0 - np.eye(m), 1.0 - np.eye(n)  # sums that leave one out, without cancellation
    free = np.ones((n, m))
    for _ in range(iterations):
        claim = ratio / (1.0 + (ratio * free) @ others)
        before, free = free, 1.0 / (1.0 + rivals @ claim)
        if np.max(np.abs(free - before), initial=0.0) < _SETTLED:
            break
    table = np.column_stack([np.ones(n), ratio * free])
    return np.asarray(table / table.sum(axis=1, keepdims=True))
