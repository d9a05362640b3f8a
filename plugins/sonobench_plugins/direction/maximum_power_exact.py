"""Maximum power with the best weights, estimated from the frame, and its exact maximiser: no step, no iteration, no weight to choose.

On |u| = 1 the likelihood of a Gaussian source in noise that is equal in the three velocities is highest, its powers given, where

    uᵀAu + 2 bᵀu,      A = (1 − alpha) C_vv,      b = alpha c_vp,      alpha = σ_v² / (σ_p² + σ_v²)

is: a quadratic on the sphere, one 3 × 3 eigenproblem and a scalar equation. Its error is the Cramér-Rao bound. With noise = "diagonal"
each velocity has its own noise; direction, power and four variances are then fitted to the covariance by Fisher scoring, to the same end.
Source: Levin, Gannot & Habets 2011 (best alpha); Nehorai & Paldi 1994 (model); Gander, Golub & von Matt 1989 (quadratic on a sphere).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.vector_sensor import Confidence, Noise, Solution, best_alpha, fitted, found, maximiser, noise_variances, sensitivity
from sonobench.types import Array, Floats


@dataclass(frozen=True)
class MaximumPowerExact:
    """One source; nothing to choose but how the noise is estimated."""

    noise: Noise = "moment"  #: "moment" or "eigen" (equal in the velocities), or "diagonal" (each velocity its own)
    confidence: Confidence = "plug-in"  #: R by "plug-in" of the frame's covariance, from "residuals" of its blocks, or "none"
    blocks: int = 20  #: parts of a frame, for "residuals"

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → one direction each; the score is the share of the energy that flows."""
        return found(samples, self.solve, self.confidence, self.blocks)

    def solve(self, C: Array) -> Solution:
        """Directions of covariances (…, 4, 4)."""
        if self.noise == "diagonal":
            fit = fitted(C)
            return Solution(fit.u, fit.M[..., :2, :, :])
        alpha = best_alpha(noise_variances(C, self.noise))[..., None]
        A, b = (1.0 - alpha[..., None]) * C[..., 1:, 1:], alpha * C[..., 1:, 0]
        u = maximiser(A, b)
        return Solution(u, sensitivity(u, A, b, np.eye(3, 4, 1), np.concatenate([alpha, (1.0 - alpha) * u], axis=-1)))
