"""Optimal sub-pattern assignment (OSPA) distance between the sets of targets and of estimates.

    d_p = ( (1/N) ( min over assignments Σ min(d, c)^p + c^p (N − M) ) )^(1/p),   N ≥ M the sizes of the two sets

Source: Schuhmacher, Vo & Vo 2008, "A consistent metric for performance evaluation of multi-object filters", eq. 3 and 4.
The assignment minimises the sum of d^p, and for p = ∞ the largest d, as the definition says; assigning on d and raising
to the power afterwards (Stone Soup 1.9 does) is not a minimum and can exceed it. Both sets empty is 0, one empty is c.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.scoring import aligned
from sonobench.types import Array, Estimate, Floats, Space, Truth


@dataclass(frozen=True)
class Ospa:
    """OSPA per frame, with its localisation and cardinality parts; the trial's number is the mean over frames."""

    p: float = 2.0  #: order, 1 to inf
    c_m: float = 1.0  #: cut-off, in the unit of the compared components (m for positions)
    components: tuple[str, ...] | None = None  #: state names to compare; None is the position
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not self.p >= 1:
            raise InputError(f"ospa: p is {self.p}; 1 or more (or inf) is needed for a metric")
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"ospa: c_m is {self.c_m}; a positive cut-off is needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "", "localisation", "cardinality"; for p < ∞ the p-th powers of the parts add up to that of the whole."""
        pairs = aligned(truth, output, space, self.hold_s, self.components, self.targets)
        parts = np.array([ospa(pairs.distances(f), self.c_m, self.p) for f in pairs.frames]).reshape(-1, 3)
        ones = np.ones(len(parts))
        names = ("", "localisation", "cardinality")
        return {name: Series(column, ones, pairs.unit) for name, column in zip(names, parts.T, strict=True)}


def ospa(distances: Floats, c: float, p: float) -> tuple[float, float, float]:
    """OSPA, its localisation part and its cardinality part of distances (n, m)."""
    small, large = sorted(distances.shape)
    if large == 0:
        return 0.0, 0.0, 0.0
    if small == 0:
        return c, 0.0, c
    cut = np.minimum(distances, c)
    if math.isinf(p):
        localisation, cardinality = bottleneck(cut), c if large > small else 0.0
        return max(localisation, cardinality), localisation, cardinality
    scale = c if p <= 32 else bottleneck(cut)  # of a large p only costs near the largest matched one stay above 0
    localisation = scale * _least_power_mean(cut / scale, p, large) if scale > 0 else 0.0
    cardinality = c * ((large - small) / large) ** (1 / p)
    top = max(localisation, cardinality)
    whole = top * ((localisation / top) ** p + (cardinality / top) ** p) ** (1 / p) if top > 0 else 0.0
    return whole, localisation, cardinality


def _least_power_mean(cost: Array, p: float, size: int) -> float:
    """(least Σ cost^p over assignments / size)^(1/p); what exceeds the number of pairs cannot be part of it."""
    with np.errstate(over="ignore"):
        powers = np.minimum(cost**p, 2.0 * size)
    return float(powers[linear_sum_assignment(powers)].sum() / size) ** (1 / p)


def bottleneck(cost: Array) -> float:
    """The least possible largest cost of an assignment of the smaller to the larger side of (n, m)."""
    levels = np.unique(cost)
    low, high = 0, len(levels) - 1
    while low < high:
        middle = (low + high) // 2
        above = (cost > levels[middle]).astype(float)
        if above[linear_sum_assignment(above)].any():
            low = middle + 1
        else:
            high = middle
    return float(levels[low])
