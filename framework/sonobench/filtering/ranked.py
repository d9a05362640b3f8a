"""The best joint assignments of several tables at once, in falling order of weight.

Source: Murty 1968, "An algorithm for ranking all the assignments in order of increasing cost"; Vo, Vo & Phung 2014, "Labeled random finite
sets and the Bayes multi-target tracking filter", for its use in the δ-GLMB; single assignments by SciPy's shortest augmenting paths.
Deviations: all tables share one queue, so that the result is the best of all children of all parents, not a fixed share of each; and a
subproblem is solved when its turn comes by a bound from below, which where rows hardly compete is most often never.
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
    """The assignments of `table` whose first `fixed` choices are as given and whose next one is none of `without`.

    Where `solved`, choice is the best of them and cost its own; else choice is one whose first choices are given, and cost a bound from below.
    """

    cost: float
    tie: int
    table: int
    fixed: int
    without: tuple[int, ...]
    choice: Ints
    solved: bool


def ranked(log_start: Array, tables: Sequence[Array], private: int) -> Iterator[tuple[float, int, Ints]]:
    """Log weight, table, and choice (n,) of every assignment that can be, the heaviest first.

    A row i of a table takes one column; a column from `private` on at most one row, those before any number of rows.

    Args:
        log_start: (H,) log weight that each table's assignments begin with.
        tables: H log weights (n, c), −inf for what cannot be; n may differ, and be 0.
        private: number of leading columns that rows do not compete for.
    """
    ties, costs = count(), [_spread(table, private) for table in tables]
    least = [cost.min(axis=1, initial=_NEVER) for cost in costs]
    queue = [_Node(-float(log_start[h]) + x.sum(), next(ties), h, 0, (), np.zeros(len(x), np.int64), False) for h, x in enumerate(least)]
    heapq.heapify(queue)
    while queue:
        node = heapq.heappop(queue)
        h, start = node.table, -float(log_start[node.table])
        if not node.solved:
            best = _best(costs[h], node, start)
            if best is not None:
                heapq.heappush(queue, best)
            continue
        n = len(node.choice)
        yield -node.cost, h, np.where(node.choice < n * private, node.choice // max(n, 1), node.choice - n * private + private)
        for i, bound in enumerate(_bounds(costs[h], least[h], node) if n else (), node.fixed):
            if bound < _NEVER:
                without = (*node.without, int(node.choice[i])) if i == node.fixed else (int(node.choice[i]),)
                heapq.heappush(queue, _Node(start + bound, next(ties), h, i, without, node.choice, False))


def _spread(table: Array, private: int) -> Array:
    """Costs (n, private n + c − private): each row has its own copy of every column that rows do not compete for."""
    n = len(table)
    cost = np.full((n, private * n + table.shape[1] - private), _NEVER)
    for k in range(private):
        cost[np.arange(n), k * n + np.arange(n)] = -table[:, k]
    cost[:, private * n :] = -table[:, private:]
    return np.minimum(cost, _NEVER)


def _bounds(cost: Array, least: Array, node: _Node) -> Array:
    """At least what the children of a solved node cost, in which row i from `fixed` on changes its choice: as if later rows did not compete."""
    n, fixed, own = len(node.choice), node.fixed, cost[np.arange(len(node.choice)), node.choice]
    free = np.array(cost[fixed:])
    free[0, list(node.without)] = _NEVER
    free[:, node.choice[:fixed]] = _NEVER
    for i in range(fixed, n):
        free[i - fixed :, node.choice[i]] = _NEVER  # its own, and for later rows a column that is taken
    before = np.concatenate([[0.0], np.cumsum(own)[:-1]])
    after = least.sum() - np.cumsum(least)
    return np.asarray(free.min(axis=1) + (before + after)[fixed:])


def _best(cost: Array, node: _Node, start: float) -> _Node | None:
    """The node with its best assignment; None where there is none."""
    fixed, free = node.fixed, np.ones(cost.shape[1], bool)
    first = node.choice[:fixed]
    free[first] = False
    columns = np.flatnonzero(free)
    rest = cost[fixed:, columns]
    if node.without:
        rest[0, np.searchsorted(columns, node.without)] = _NEVER
    rows, taken = linear_sum_assignment(rest)
    left = rest[rows, taken]
    if np.any(left >= _NEVER):
        return None
    choice = np.concatenate([first, columns[taken]]).astype(np.int64)
    total = start + float(cost[np.arange(fixed), first].sum() + left.sum())
    return node._replace(cost=total, choice=choice, solved=True)
