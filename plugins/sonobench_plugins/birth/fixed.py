"""Births at the same places in every scan, as parameters.

Source: Vo & Ma 2006, eq. 15; Chen, Chen, Yin & Hou 2012, eq. 18, whose prior of the first scan is `once`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.types import Array, Scan, Setup, Space, read_only


@dataclass(frozen=True, eq=False)
class Fixed:
    """A Gaussian mixture of births; memory is whether the next scan is the first."""

    means: Array  #: (n, d) in the state's order and units
    variances: Array  #: (n, d) diagonals of the covariances, or (1, d) for all
    weights: Array  #: (n,) expected births a scan, or (1,) for all
    once: int = 0  #: this many leading rows are born at the first scan only

    def __post_init__(self) -> None:
        means = read_only(self.means, shape=(None, None), name="means")
        n, d = means.shape
        variances = read_only(self.variances, shape=(None, d), name="variances")
        weights = read_only(self.weights, shape=(None,), name="weights")
        if len(variances) not in (1, n) or len(weights) not in (1, n):
            raise ValueError(f"{len(variances)} rows of variances and {len(weights)} weights for {n} means; 1 or {n} are needed")
        if (variances < 0).any() or (weights < 0).any():
            raise ValueError("variances and weights must not be negative")
        if not 0 <= self.once <= n:
            raise ValueError(f"once is {self.once}; 0 to {n}, the number of means, is needed")
        object.__setattr__(self, "means", means)
        object.__setattr__(self, "variances", read_only(np.broadcast_to(variances, (n, d))))
        object.__setattr__(self, "weights", read_only(np.broadcast_to(weights, n)))

    @property
    def uses_scan(self) -> bool:
        """A prior."""
        return False

    def start(self, space: Space, setup: Setup, measurement: BoundMeasurement) -> State:
        """True: the next scan is the first.

        Raises:
            SetupError: the means are of another dimension than the state.
        """
        if self.means.shape[1] != len(space):
            raise SetupError(f"birth fixed has means of {self.means.shape[1]} numbers; the state space is {list(space.names)}")
        return True

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """All rows at the first scan, those after `once` later."""
        keep = slice(0 if memory else self.once, None)
        m = self.means[keep]
        P = self.variances[keep][:, :, None] * np.eye(m.shape[1])
        return False, Mixture(self.weights[keep], m, P, np.zeros(len(m), np.int64))
