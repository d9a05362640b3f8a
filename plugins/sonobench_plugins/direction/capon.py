"""The direction in which Capon's beamformer lets the most power through: the highest 1 / (aᵀ C⁻¹ a), a = [1; u], exactly.

aᵀ C⁻¹ a is a quadratic on the sphere, so that no search over azimuth and elevation is needed. It adapts to the ratio of the pressure's
noise to the velocities'; noise that differs between the velocities pulls it towards where C⁻¹ is small.
Source: Hawkes & Nehorai 1998, "Acoustic vector-sensor beamforming and Capon direction estimation".
Deviations: Hu, Li & Jin 2014 search a grid of .1° over 0 to 60° (12.5 s a direction); the maximiser here is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.vector_sensor import Confidence, Solution, found, maximiser, mean_power, sensitivity
from sonobench.types import Array, Floats


@dataclass(frozen=True)
class Capon:
    """One source: the highest point of the spectrum."""

    loading: float = 1e-9  #: added to the diagonal of C, over its mean: keeps C⁻¹ finite where there is no noise
    confidence: Confidence = "plug-in"  #: R by "plug-in" of the frame's covariance, from "residuals" of its blocks, or "none"
    blocks: int = 20  #: parts of a frame, for "residuals"

    def __post_init__(self) -> None:
        if not self.loading > 0:
            raise ValueError(f"loading is {self.loading}; above 0 is needed")

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → one direction each; the score is the share of the energy that flows."""
        return found(samples, self.solve, self.confidence, self.blocks)

    def solve(self, C: Array) -> Solution:
        """Directions of covariances (…, 4, 4)."""
        level = mean_power(C)[..., None, None]
        P = np.linalg.inv(C / level + self.loading * np.eye(4))
        A, b = -P[..., 1:, 1:], -P[..., 1:, 0]
        u = maximiser(A, b)
        right = P[..., 0] + np.einsum("...ij,...j->...i", P[..., 1:], u)
        return Solution(u, sensitivity(u, A, b, P[..., 1:, :], right) / level[..., None])
