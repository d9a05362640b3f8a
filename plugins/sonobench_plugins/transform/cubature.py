"""Third-degree spherical-radial cubature: 2 d points at √d standard deviations, equal weights.

Source: Arasaratnam & Haykin 2009, "Cubature Kalman filters"; Chen, Chen, Yin & Hou 2012, eq. 2 to 4 and 8 to 11.
Deviations: eq. 10 and 11 subtract ẑ ẑᵀ from a mean of squares; the same moments are taken here from centred points, which
does not cancel. The points are drawn anew from the predicted Gaussian, as eq. 27 says.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.filtering.points import image_moments, spread
from sonobench.protocols import BoundMeasurement
from sonobench.types import Array


@dataclass(frozen=True)
class Cubature:
    """Moments from cubature points."""

    def points(self, m: Array, P: Array) -> tuple[Array, Array]:
        """m ± √d · columns of a root of P, (…, 2 d, d), weights 1 / 2 d (eq. 3)."""
        d = np.shape(m)[-1]
        return spread(m, P, np.sqrt(d)), np.full(2 * d, 0.5 / d)

    def measure(self, m: Array, P: Array, measurement: BoundMeasurement, q: int, pose: Array | None = None) -> tuple[Array, Array, Array]:
        """ẑ, covariance and cross-covariance of the points' images (eq. 9 to 11, without R)."""
        x, w = self.points(m, P)
        return image_moments(x, m, w, w, measurement, q, pose)
