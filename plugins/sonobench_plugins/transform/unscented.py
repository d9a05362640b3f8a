"""The scaled unscented transform: 2 d + 1 points.

lambda = alpha² (d + kappa) − d; points m and m ± √(d + lambda) · columns of a root of P.
Source: Julier 2002, "The scaled unscented transformation"; Wan & van der Merwe 2000; Vo & Ma 2006, table IV.
With alpha = 1 and beta = 0, the defaults, it is the transform of Julier & Uhlmann 2004, "Unscented filtering and nonlinear
estimation", with their kappa; with kappa = 0 the central point has no weight and the transform is `Cubature`. beta = 2 is the
choice for a Gaussian and a small alpha. A negative kappa gives the central point a negative weight, and the covariance of
a strongly bent h may then have a negative eigenvalue, which the update refuses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.filtering.points import image_moments, spread
from sonobench.protocols import BoundMeasurement
from sonobench.types import Array


@dataclass(frozen=True)
class Unscented:
    """Moments from sigma points."""

    alpha: float = 1.0  #: scale of the points' spread
    beta: float = 0.0  #: weight added to the central point's covariance; 2 suits a Gaussian and a small alpha
    kappa: float = 0.0  #: second scale; d + kappa must be above 0

    def __post_init__(self) -> None:
        if not self.alpha > 0:
            raise ValueError(f"alpha is {self.alpha}; above 0 is needed")

    def _scale(self, d: int) -> float:
        scale = self.alpha**2 * (d + self.kappa)
        if not scale > 0:
            raise ValueError(f"kappa is {self.kappa} for a state of {d} dimensions; above {-d} is needed")
        return scale

    def points(self, m: Array, P: Array) -> tuple[Array, Array]:
        """m and m ± √(d + lambda) · columns, (…, 2 d + 1, d), and the weights of a mean."""
        d = np.shape(m)[-1]
        scale = self._scale(d)
        x = np.concatenate([np.asarray(m)[..., None, :], spread(m, P, np.sqrt(scale))], axis=-2)
        return x, np.concatenate([[1 - d / scale], np.full(2 * d, 0.5 / scale)])

    def measure(self, m: Array, P: Array, measurement: BoundMeasurement, q: int, pose: Array | None = None) -> tuple[Array, Array, Array]:
        """ẑ, covariance and cross-covariance of the points' images, without R."""
        x, w = self.points(m, P)
        w_cov = w.copy()
        w_cov[0] += 1 - self.alpha**2 + self.beta
        return image_moments(x, m, w, w_cov, measurement, q, pose)
