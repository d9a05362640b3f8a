"""Maximum power with fixed weights after whitening (WPF-MP): noise is made equal on all channels first, and alpha is .5.

1. Q̂, the variances of the noise, from the frame's covariance; 2. C' = Q̂^−½ C Q̂^−½; 3. q from gradient ascent with alpha = .5 on C';
4. û along Q̂_v^½ q.
Source: Hu, Li & Jin 2014, section 3.1, eq. 8 to 10 and the list below them.
Deviations:
- Step 5 lets q grow without end; it is renormalised here in every iteration (literal "unnormalised": as printed).
- Step 6 takes q for the direction; but whitening has bent it, and where the velocities' noise differs Q̂_v^½ must bend it back
  (literal "whitened": as printed, some ten times the bound there; no difference where it is equal).
- Eq. 8 writes the velocities' noise as σ_v² I, which is not the "non-uniform" noise that the paper speaks of; noise = "diagonal" is. The paper
  leaves the estimator of Q̂ to Wu & Hou 2006; three are offered here.
- alpha = .5 after whitening is σ_v / (σ_p + σ_v) on the raw data, not σ_v² / (σ_p² + σ_v²): not the optimum, unless σ_p = σ_v.
- The step is over the power of the whitened pressure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.vector_sensor import (
    Confidence,
    Noise,
    Solution,
    ascended,
    axes,
    fitted,
    found,
    noise_variances,
    sensitivity,
    with_noise_error,
)
from sonobench.types import Array, Floats

Literally = Literal["unnormalised", "whitened"]


@dataclass(frozen=True)
class WpfMp:
    """One source."""

    noise: Noise = "moment"  #: "moment" or "eigen" (equal in the velocities), or "diagonal" (each velocity its own)
    step: float = 5.0  #: mu, over the power of the whitened pressure
    tolerance: float = 1e-5  #: a q that moves by less stops
    iterations: int = 50  #: at most
    literal: tuple[Literally, ...] = ()  #: what is done as printed: "unnormalised" (q grows), "whitened" (q is the direction)
    confidence: Confidence = "plug-in"  #: R by "plug-in" of the frame's covariance, from "residuals" of its blocks, or "none"
    blocks: int = 20  #: parts of a frame, for "residuals"

    def __post_init__(self) -> None:
        if not (self.step > 0 and self.tolerance >= 0 and self.iterations >= 1):
            raise ValueError(f"step is {self.step}, tolerance {self.tolerance}, iterations {self.iterations}; above 0, 0 and 1 are needed")

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → one direction each; the score is the share of the energy that flows."""
        return found(samples, self.solve, self.confidence, self.blocks)

    def solve(self, C: Array) -> Solution:
        """Directions of covariances (…, 4, 4)."""
        fit = fitted(C) if self.noise == "diagonal" else None
        deviation = np.sqrt(noise_variances(C, self.noise) if fit is None else fit.noise)
        white = C / (deviation[..., :, None] * deviation[..., None, :])
        A, b = 0.5 * white[..., 1:, 1:], 0.5 * white[..., 1:, 0]
        power = np.maximum(white[..., 0, 0], np.finfo(float).tiny)[..., None]
        q = ascended(A / power[..., None], b / power, self.step, self.tolerance, self.iterations, "unnormalised" not in self.literal)
        weights = 0.5 * np.concatenate([np.ones((*q.shape[:-1], 1)), q], axis=-1) / deviation
        M = sensitivity(q, A, b, np.eye(3, 4, 1) / deviation[..., 1:, None], weights)
        M = M if fit is None else with_noise_error(M, fit)
        if "whitened" in self.literal:
            return Solution(q, M)
        bent = deviation[..., 1:] * q
        length = np.linalg.norm(bent, axis=-1, keepdims=True)
        u = bent / length
        turn = (axes(u) * (deviation[..., 1:] / length)[..., None, :]) @ np.swapaxes(axes(q), -1, -2)
        return Solution(u, np.einsum("...ab,...bij->...aij", turn, M))
