"""Births at the same places in every scan, as parameters.

Source: Vo & Ma 2006, eq. 15; Chen, Chen, Yin & Hou 2012, eq. 18, whose prior at k = 0 is `once`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import BoundMeasurement, Mixture, State
from sonobench.types import Array, Scan, Setup, Space, read_only


@dataclass(frozen=True, eq=False)
class Fixed:
    """A Gaussian mixture of births; no memory."""

    means: Array  #: (n, d) in the state's order and units
    variances: Array  #: (n, d) diagonals of the covariances, or (1, d) for all
    weights: Array  #: (n,) expected births a scan, or (1,) for all
    once: int = 0  #: this many leading rows exist at the recording's start, and are not born later

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
        """Nothing to remember.

        Raises:
            SetupError: the means are of another dimension than the state.
        """
        if self.means.shape[1] != len(space):
            raise SetupError(f"birth fixed has means of {self.means.shape[1]} numbers; the state space is {list(space.names)}")
        return None

    def propose(self, rng: np.random.Generator, memory: State, scan: Scan, live: Mixture) -> tuple[State, Mixture]:
        """The rows after `once`."""
        return None, self._rows(slice(self.once, None))

    def initial(self, memory: State) -> Mixture:
        """The first `once` rows."""
        return self._rows(slice(self.once))

    def _rows(self, which: slice) -> Mixture:
        m = self.means[which]
        P = self.variances[which][:, :, None] * np.eye(m.shape[1])
        return Mixture(self.weights[which], m, P, np.zeros(len(m), np.int64))
