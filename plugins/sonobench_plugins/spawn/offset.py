"""Targets that split off others, at fixed offsets.

Each component (w, m, P) of the posterior, moved to the scan by the motion model, gives for each row i
w_i w N(m + offset_i, P + diag(variance_i)).
Source: Vo & Ma 2006, eq. 22 and 27 to 29; Chen, Chen, Yin & Hou 2012, eq. 17.
Deviations: their F_beta is the motion model's transition, and their Q_beta adds to its process noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.protocols import Mixture
from sonobench.types import Array, read_only


@dataclass(frozen=True, eq=False)
class Offset:
    """J_beta spawned components for each component."""

    weights: Array  #: (J_beta,) expected spawned targets a target and scan
    offsets: Array  #: (J_beta, d) from the moved mean, in the state's order and units
    variances: Array  #: (J_beta, d) diagonals added to the moved covariance, or (1, d) for all

    def __post_init__(self) -> None:
        offsets = read_only(self.offsets, shape=(None, None), name="offsets")
        n, d = offsets.shape
        weights = read_only(self.weights, shape=(n,), name="weights")
        variances = read_only(self.variances, shape=(None, d), name="variances")
        if len(variances) not in (1, n):
            raise ValueError(f"{len(variances)} rows of variances for {n} offsets; 1 or {n} are needed")
        if (weights < 0).any() or (variances < 0).any():
            raise ValueError("weights and variances must not be negative")
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "offsets", offsets)
        object.__setattr__(self, "variances", read_only(np.broadcast_to(variances, (n, d))))

    def spawned(self, moved: Mixture) -> Mixture:
        """J_beta components for each of the mixture's, those of one row together.

        Raises:
            SetupError: the offsets are of another dimension than the state.
        """
        n, d = self.offsets.shape
        J = len(moved.w)
        if moved.m.shape[1] != d:
            raise SetupError(f"spawn offset has offsets of {d} numbers; the state has {moved.m.shape[1]}")
        w = self.weights[:, None] * moved.w
        m = self.offsets[:, None] + moved.m
        P = (self.variances[:, None, :, None] * np.eye(d)) + moved.P
        return Mixture(w.ravel(), m.reshape(n * J, d), P.reshape(n * J, d, d), np.tile(moved.mode, n))
