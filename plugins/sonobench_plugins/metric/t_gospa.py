"""T-GOSPA: the GOSPA of trajectories, which also charges a track that changes its target.

    d^p = min over W  Σ_k Σ_ij D_k(i, j) W_k(i, j)  +  (γ^p / 2) Σ_k Σ_ij |W_k(i, j) − W_{k+1}(i, j)|

D_k is min(d, c)^p where both exist, c^p / 2 where one does; W_k(i, j) ≥ 0 says how much target i is track j at time k, rows and columns sum to
at most one, and what is missing to one is unassigned. A change of label costs γ^p, a change from or to nobody half of that.
Source: García-Fernández, Rahmathullah & Svensson 2020, "A metric on the space of finite sets of trajectories for evaluation of multi-target
tracking algorithms", IEEE Trans. Signal Processing 68, eq. 17 and 23 to 26 (the linear programme, itself a metric, never above the integer one).
Deviations: the sum over time is divided by the number of times before the root is taken, so that long and short trials compare. Pairs that are
never within c are left out, which changes nothing: to leave them unassigned costs the same and never switches.
Unlabelled estimates are no tracks: the metric is then undefined (NaN, coverage 0).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from sonobench.errors import InputError
from sonobench.protocols import Series
from sonobench.scoring import Aligned, aligned
from sonobench.types import Array, Estimate, Ints, Space, Truth

_NAMES = ("", "localisation", "missed", "false", "switch")


class Pairs(NamedTuple):
    """Pairs of a target and a track that are within c at some time: i (P,), j (P,), and cost (K, P) = (d / c)^p, 1 where they are not."""

    i: Ints
    j: Ints
    cost: Array


@dataclass(frozen=True)
class TGospa:
    """T-GOSPA of a trial, an average over its times, and its parts; the p-th powers of the parts add up to that of the whole."""

    p: float = 2.0  #: order, 1 to 32
    c_m: float = 1.0  #: cut-off, in the unit of the compared components (m for positions, rad for directions)
    switch_m: float = 0.5  #: γ, the price of a switch, in the same unit
    components: tuple[str, ...] | None = None  #: state names to compare; None is the position
    targets: Literal["exists", "active"] = "exists"  #: truth that counts
    hold_s: float | None = None  #: how long an estimate stands; None is 1.5 periods

    def __post_init__(self) -> None:
        if not 1 <= self.p <= 32:
            raise InputError(f"t-gospa: p is {self.p}; it lies in [1, 32]")
        if not (self.c_m > 0 and self.switch_m > 0 and math.isfinite(self.c_m + self.switch_m)):
            raise InputError(f"t-gospa: c_m is {self.c_m}, switch_m {self.switch_m}; positive numbers are needed")

    def evaluate(self, truth: Truth, output: Sequence[Estimate], space: Space | None) -> Mapping[str, Series]:
        """Columns "", "localisation", "missed", "false", "switch", one value a trial that weighs its number of times.

        Raises:
            InputError: a label comes twice in one estimate.
        """
        pairs = aligned(truth, output, space, self.hold_s, self.components, self.targets)
        times = len(pairs.frames)
        if any(f.labels is None for f in pairs.frames):
            return {name: Series(np.array([np.nan]), np.zeros(1), pairs.unit, pool="rms", coverage=0.0) for name in _NAMES}
        there, found = (
            (sum(len(x) for x in side) for side in zip(*((f.truth, f.estimates) for f in pairs.frames), strict=True)) if times else (0, 0)
        )
        near, hits, moved = solved(_pairs(pairs, self.c_m, self.p), (self.switch_m / self.c_m) ** self.p)
        parts = [near, (there - hits) / 2, (found - hits) / 2, moved]
        values = [self.c_m * (max(v, 0.0) / max(times, 1)) ** (1 / self.p) for v in (sum(parts), *parts)]
        return {
            name: Series(np.array([value]), np.array([float(times)]), pairs.unit, pool="rms" if self.p == 2 else "mean")
            for name, value in zip(_NAMES, values, strict=True)
        }


def solved(pairs: Pairs, switch: float) -> tuple[float, float, float]:
    """Cost of localisation, number of matches and cost of switches of the linear programme's optimum, in units of c^p.

    Args:
        pairs: the pairs that may be matched.
        switch: (γ / c)^p.
    """
    K, P = pairs.cost.shape
    if K == 0 or P == 0:
        return 0.0, 0.0, 0.0
    from scipy.optimize import linprog
    from scipy.sparse import coo_array, eye_array, hstack, kron, vstack

    side = [coo_array((np.ones(P), (np.unique(who, return_inverse=True)[1], np.arange(P)))) for who in (pairs.i, pairs.j)]
    at_most_one = kron(eye_array(K), vstack(side))
    step = kron(eye_array(K - 1, K, k=1) - eye_array(K - 1, K), eye_array(P)) if K > 1 else coo_array((0, P))
    changes = step.shape[0]
    none = coo_array((at_most_one.shape[0], changes))
    A = vstack([hstack([at_most_one, none]), hstack([step, -eye_array(changes)]), hstack([-step, -eye_array(changes)])])
    b = np.concatenate([np.ones(at_most_one.shape[0]), np.zeros(2 * changes)])
    gain = np.concatenate([(pairs.cost - 1.0).ravel(), np.full(changes, switch / 2)])
    result = linprog(gain, A_ub=A.tocsr(), b_ub=b, bounds=(0, None), method="highs")
    if result.status != 0:
        raise InputError(f"t-gospa: the linear programme of {K} times and {P} pairs was not solved ({result.message})")
    W = result.x[: K * P].reshape(K, P)
    hit = W * (pairs.cost < 1.0)
    return float((hit * pairs.cost).sum()), float(hit.sum()), float(switch / 2 * np.abs(np.diff(W, axis=0)).sum())


def _pairs(pairs: Aligned, c: float, p: float) -> Pairs:
    """Pairs of all frames; labels are numbered within the trial."""
    mine = np.unique(np.concatenate([np.zeros(0, np.int64), *(f.truth_labels for f in pairs.frames)]))
    theirs = np.unique(np.concatenate([np.zeros(0, np.int64), *(np.asarray(f.labels) for f in pairs.frames)]))
    cost = np.ones((len(pairs.frames), len(mine), len(theirs)))
    for k, frame in enumerate(pairs.frames):
        labels = np.asarray(frame.labels)
        if len(np.unique(labels)) < len(labels):
            raise InputError(
                f"t-gospa: labels {labels.tolist()} at {frame.time_s} s; a track is at one place at a time, give each row its own label"
            )
        at = np.ix_(np.searchsorted(mine, frame.truth_labels), np.searchsorted(theirs, labels))
        cost[k][at] = (np.minimum(pairs.distances(frame), c) / c) ** p
    i, j = np.nonzero((cost < 1.0).any(axis=0))
    return Pairs(i.astype(np.int64), j.astype(np.int64), cost[:, i, j])
