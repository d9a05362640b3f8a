"""Set distances by enumeration of every assignment: the definitions, without an assignment solver."""

from __future__ import annotations

import itertools
import math

import numpy as np


def assignments(n, m):
    """Every way to give each of the smaller side its own partner on the larger side, as (rows, columns)."""
    if n <= m:
        return [(list(range(n)), list(c)) for c in itertools.permutations(range(m), n)]
    return [(list(r), list(range(m))) for r in itertools.permutations(range(n), m)]


def brute_ospa(d, c, p):
    """Schuhmacher et al. 2008, eq. 3 and 4."""
    n, m = d.shape
    size, absent = max(n, m), abs(n - m)
    if size == 0:
        return 0.0
    if math.isinf(p):
        return c if absent else min(max(min(d[i, j], c) for i, j in zip(r, q, strict=True)) for r, q in assignments(n, m))
    best = min(sum(min(d[i, j], c) ** p for i, j in zip(r, q, strict=True)) for r, q in assignments(n, m))
    return ((best + c**p * absent) / size) ** (1 / p)


def brute_gospa(d, c, p, alpha=2.0):
    """Rahmathullah et al. 2017, eq. 1; for alpha 2 by eq. 4, over every partial matching."""
    n, m = d.shape
    if alpha == 2.0:
        costs = [
            sum(d[i, j] ** p for i, j in zip(rows, columns, strict=True)) + c**p / 2 * (n + m - 2 * size)
            for size in range(min(n, m) + 1)
            for rows in itertools.combinations(range(n), size)
            for columns in itertools.permutations(range(m), size)
        ]
        return min(costs) ** (1 / p)
    best = min(sum(min(d[i, j], c) ** p for i, j in zip(r, q, strict=True)) for r, q in assignments(n, m))
    return (best + c**p / alpha * abs(n - m)) ** (1 / p)


def distances(x, y):
    return np.linalg.norm(x[:, None] - y[None], axis=-1)
