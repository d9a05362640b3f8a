"""The direction in which a weighted sum of pressure and velocity has the greatest mean power, found by gradient ascent.

    û = argmax over |q| = 1 of mean[(alpha p + (1 − alpha) qᵀ v)²],      q ← (q + mu [alpha c_vp + (1 − alpha) C_vv q]) / |…|

from the intensity on. alpha = 1 is the intensity; the least error takes alpha = σ_v² / (σ_p² + σ_v²) (`maximum-power-exact`).
Source: Levin, Gannot & Habets 2011; Hu, Li & Jin 2014, eq. 5 to 7.
Deviations: eq. 7 lets q grow without end, which forgets c_vp and ends at the highest eigenvector of C_vv; q is renormalised in every
iteration here, as Levin et al. do (literal = "unnormalised" is as printed). The step is over the power of the pressure, so
that loudness does not matter; at the paper's powers its mu = 1 is a step of 4.7.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.vector_sensor import Confidence, Solution, ascended, found, sensitivity
from sonobench.types import Array, Floats


@dataclass(frozen=True)
class MaximumPower:
    """One source; weight `alpha` of the pressure."""

    alpha: float = 0.5  #: weight of the pressure, 1 − alpha is that of the velocity
    step: float = 5.0  #: mu, over the power of the pressure
    tolerance: float = 1e-5  #: a q that moves by less stops
    iterations: int = 50  #: at most
    literal: Literal["", "unnormalised"] = ""  #: "unnormalised": q as printed, never renormalised
    confidence: Confidence = "plug-in"  #: R by "plug-in" of the frame's covariance, from "residuals" of its blocks, or "none"
    blocks: int = 20  #: parts of a frame, for "residuals"

    def __post_init__(self) -> None:
        if not 0 <= self.alpha <= 1:
            raise ValueError(f"alpha is {self.alpha}; 0 to 1 is needed")
        if not (self.step > 0 and self.tolerance >= 0 and self.iterations >= 1):
            raise ValueError(f"step is {self.step}, tolerance {self.tolerance}, iterations {self.iterations}; above 0, 0 and 1 are needed")

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → one direction each; the score is the share of the energy that flows."""
        return found(samples, self.solve, self.confidence, self.blocks)

    def solve(self, C: Array) -> Solution:
        """Directions of covariances (…, 4, 4)."""
        A, b = (1.0 - self.alpha) * C[..., 1:, 1:], self.alpha * C[..., 1:, 0]
        power = np.maximum(C[..., 0, 0], np.finfo(float).tiny)[..., None]
        u = ascended(A / power[..., None], b / power, self.step, self.tolerance, self.iterations, self.literal != "unnormalised")
        weights = np.concatenate([np.full((*u.shape[:-1], 1), self.alpha), (1.0 - self.alpha) * u], axis=-1)
        return Solution(u, sensitivity(u, A, b, np.eye(3, 4, 1), weights))
