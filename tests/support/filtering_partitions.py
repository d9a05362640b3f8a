"""The PHD update of targets with several detections as it is written down: every partition listed, every L_W from its definition."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence

import numpy as np


def partitions(items: Sequence[int]) -> Iterator[list[list[int]]]:
    """All ways to split items into sets."""
    if not items:
        yield []
        return
    first, rest = items[0], items[1:]
    for found in partitions(rest):
        yield [[first], *found]
        for k in range(len(found)):
            yield [*found[:k], [first, *found[k]], *found[k + 1 :]]


def likelihood(rows: Sequence[int], pg: np.ndarray, miss: np.ndarray) -> np.ndarray:
    """L_W(x) (N,) of the rows W: pg (N, L, m), miss (N, L); the sum over all ways to give its members to modes."""
    modes = miss.shape[1]
    total = np.zeros(len(pg))
    for ways in itertools.permutations(range(modes), len(rows)):
        detected = np.prod([pg[:, mode, z] for mode, z in zip(ways, rows, strict=True)], axis=0)
        total += detected * np.prod([miss[:, mode] for mode in range(modes) if mode not in ways], axis=0)
    return total


def listed(w: np.ndarray, pg: np.ndarray, miss: np.ndarray, kappa: np.ndarray) -> np.ndarray:
    """The factor of each particle (N,): Liang 2016, eq. 5-29 to 5-34, omega_P being d_W's product over P's share of all partitions'."""
    total, sum_over_partitions = 0.0, np.zeros(len(pg))
    for found in partitions(list(range(len(kappa)))):
        each = [likelihood(rows, pg, miss) for rows in found]
        d = [w @ one + (kappa[rows[0]] if len(rows) == 1 else 0.0) for rows, one in zip(found, each, strict=True)]
        total += np.prod(d)
        for k, one in enumerate(each):
            sum_over_partitions += one * np.prod(d[:k] + d[k + 1 :])
    return miss.prod(axis=1) + sum_over_partitions / total
