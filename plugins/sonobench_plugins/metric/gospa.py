"""Generalised OSPA (GOSPA): the errors of matched targets plus a price for each missed and each false one.

    d = ( min over assignments Σ min(d, c)^p + (c^p / α) (N − M) )^(1/p),   N ≥ M the sizes of the two sets

For α = 2 this is the sum over matched pairs closer than c, plus c^p / 2 for every missed target and every false
estimate: a pair at c or more is no match. Unlike OSPA it is not divided by N.

Source: Rahmathullah, García-Fernández & Svensson 2017, "Generalized optimal sub-pattern assignment metric", eq. 1 and 4.
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
from sonobench.types import Estimate, Floats, Space, Truth


@dataclass(frozen=True)
class Gospa:
    """GOSPA per frame with its localisation, missed and false parts; the trial's number is the mean over frames."""

    p: float = 2.0  #: order, 1 to 32
    c_m: float = 1.0  #: cut-off, in the unit of the compared components (m for positions)
    alpha: float = 2.0  #: price of an absent target is c^p / alpha, in (0, 2]; below 2 a pair beyond the cut-off stays a pair
    components: tuple[str, ...] | None = None  #: state names to compare; None is the position
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not 1 <= self.p <= 32:  # beyond, powers of small errors fall out of the range of a float
            raise InputError(f"gospa: p is {self.p}; it lies in [1, 32]")
        if not (self.c_m > 0 and math.isfinite(self.c_m)):
            raise InputError(f"gospa: c_m is {self.c_m}; a positive cut-off is needed")
        if not 0 < self.alpha <= 2:
            raise InputError(f"gospa: alpha is {self.alpha}; it lies in (0, 2]")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "", "localisation", "missed", "false"; the p-th powers of the parts add up to that of the whole."""
        pairs = aligned(truth, output, space, self.hold_s, self.components, self.targets)
        parts = np.array([gospa(pairs.distances(f), self.c_m, self.p, self.alpha) for f in pairs.frames]).reshape(-1, 4)
        ones = np.ones(len(parts))
        names = ("", "localisation", "missed", "false")
        return {name: Series(column, ones, pairs.unit) for name, column in zip(names, parts.T, strict=True)}


def gospa(distances: Floats, c: float, p: float, alpha: float = 2.0) -> tuple[float, float, float, float]:
    """GOSPA, localisation, missed and false parts of distances (n truth, m estimates)."""
    n, m = distances.shape
    powers = (np.minimum(distances, c) / c) ** p
    pairs = linear_sum_assignment(powers)
    matched = distances[pairs] < c if alpha == 2 else np.ones(len(pairs[0]), bool)
    count = int(matched.sum())
    near = float(powers[pairs][matched].sum())
    missed, false = (n - count) / alpha, (m - count) / alpha
    if alpha < 2:  # each surplus target costs once; nothing else is absent
        missed, false = max(n - m, 0) / alpha, max(m - n, 0) / alpha
    whole, *parts = (c * cost ** (1 / p) for cost in (near + missed + false, near, missed, false))
    return whole, parts[0], parts[1], parts[2]
