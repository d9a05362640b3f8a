"""The cheapest pairing of two sets."""

from __future__ import annotations

import numpy as np

from sonobench.types import Array, Ints


def assign(cost: Array, limit: float = np.inf) -> tuple[Ints, Ints]:
    """Rows and columns (k,), (k,) of the cheapest pairing of cost (n, m) whose every pair costs less than `limit`.

    A pair saves `limit` minus its cost, so with a finite limit the total of min(cost, limit) is what is minimised and
    pairs at or over the limit stay single. Costs may be infinite (never paired).

    Raises:
        ValueError: a cost is NaN.
    """
    from scipy.optimize import linear_sum_assignment

    cost = np.asarray(cost, float)
    if np.isnan(cost).any():
        raise ValueError("an assignment cost is NaN")
    finite = cost[np.isfinite(cost)]
    ceiling = limit if np.isfinite(limit) else (np.abs(finite).max(initial=0.0) * 2 + 1) * (min(cost.shape) + 1)
    rows, columns = linear_sum_assignment(np.minimum(cost, ceiling))
    kept = cost[rows, columns] < ceiling
    return rows[kept].astype(np.int64), columns[kept].astype(np.int64)
