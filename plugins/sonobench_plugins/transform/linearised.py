"""First-order linearisation at the mean: the extended Kalman filter's moments.

Source: Jazwinski 1970, "Stochastic processes and filtering theory", section 8.3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.filtering.gaussian import symmetric
from sonobench.protocols import BoundMeasurement
from sonobench.types import Array


@dataclass(frozen=True)
class Linearised:
    """Moments through the analytic Jacobian."""

    def points(self, m: Array, P: Array) -> tuple[Array, Array]:
        """The mean itself, (…, 1, d)."""
        return np.asarray(m)[..., None, :], np.ones(1)

    def measure(self, m: Array, P: Array, measurement: BoundMeasurement, q: int, pose: Array | None = None) -> tuple[Array, Array, Array]:
        """h(m), H P Hᵀ and P Hᵀ."""
        z_hat = measurement.h(m, q, pose)[..., 0, :]
        H = measurement.jacobian(m, q, pose)[..., 0, :, :]
        cross = P @ np.swapaxes(H, -1, -2)
        S = H @ cross
        return np.asarray(z_hat, float), symmetric(S), cross
