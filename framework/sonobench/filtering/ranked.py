"""The best joint assignments of several tables at once, in falling order of weight.

Source: Murty 1968, "An algorithm for ranking all the assignments in order of increasing cost"; Vo, Vo & Phung 2014, "Labeled random finite
sets and the Bayes multi-target tracking filter", for its use in the δ-GLMB; single assignments by SciPy's shortest augmenting paths.
Deviations: all tables share one queue, so that the result is the best of all children of all parents, not a fixed share of each.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from sonobench.types import Array, Ints

_NEVER = 1e9  # the cost of what cannot be; above any sum of costs that can


class _Node(NamedTuple):
    """The best assignment of `table` whose first `fixed` choices are as given and whose next one is none of `without`."""

    cost: float
    tie: int
    table: int
    fixed: int
    without: tuple[int, ...]
    choice: Ints


def ranked(log_start: Array, tables: Sequence[Array], private: int) -> Iterator[tuple[float, int, Ints]]:
    """Log weight, table, and choice (n,) of every assignment that can be, the heaviest first.

    A row i of a table takes one column; a column from `private` on at most one row, those before any number of rows.

    Args:
        log_start: (H,) log weight that each table's assignments begin with.
        tables: H log weights (n, c), −inf for what cannot be; n may differ, and be 0.
        private: number of leading columns that rows do not compete for.
    """
    ties, costs = count(), [_spread(table, private) for table in tables]
    queue = [
        node
        for h, cost in enumerate(costs)
        if (node := _best(cost, h, 0, (), np.zeros(0, np.int64), -float(log_start[h]), ties)) is not None
    ]
    heapq.heapify(queue)
    while queue:
        node = heapq.heappop(queue)
        n = len(node.choice)
        yield -node.cost, node.table, np.where(node.choice < n * private, node.choice // max(n, 1), node.choice - n * private + private)
        cost, start = costs[node.table], -float(log_start[node.table])
        for i in range(node.fixed, n):
            without = (*node.without, int(node.choice[i])) if i == node.fixed else (int(node.choice[i]),)
            other = _best(cost, node.table, i, without, node.choice[:i], start, ties)
            if other is not None:
                heapq.heappush(queue, other)


def _spread(table: Array, private: int) -> Array:
    """Costs (n, private n + c − private): each row has its own copy of every column that rows do not compete for."""
    n = len(table)
    cost = np.full((n, private * n + table.shape[1] - private), _NEVER)
    for k in range(private):
        cost[np.arange(n), k * n + np.arange(n)] = -table[:, k]
    cost[:, private * n :] = -table[:, private:]
    return np.minimum(cost, _NEVER)


def _best(cost: Array, table: int, fixed: int, without: tuple[int, ...], first: Ints, start: float, ties: Iterator[int]) -> _Node | None:
    """The best assignment under these constraints; None where there is none."""
    free = np.ones(cost.shape[1], bool)
    free[first] = False
    columns = np.flatnonzero(free)
    rest = cost[fixed:, columns]
    if without:
        rest[0, np.searchsorted(columns, without)] = _NEVER
    rows, taken = linear_sum_assignment(rest)
    left = rest[rows, taken]
    if np.any(left >= _NEVER):
        return None
    choice = np.concatenate([first, columns[taken]]).astype(np.int64)
    total = start + float(cost[np.arange(fixed), first].sum() + left.sum())
    return _Node(total, next(ties), table, fixed, without, choice)
