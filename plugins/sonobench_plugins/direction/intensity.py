"""The direction in which sound energy flows: the mean product of pressure and velocity, pointing to the source.

The cheapest estimator, and unbiased whatever the noise of the channels is, as long as that of the pressure and of the velocities have
nothing in common. Maximum power with alpha = 1: its error is above the bound wherever the pressure's noise counts.
Source: Nehorai & Paldi 1994, section IV.A (intensity-based algorithm).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Directions
from sonobench.signal.vector_sensor import Confidence, Solution, audible, axes, found, symmetric
from sonobench.types import Array, Floats


@dataclass(frozen=True)
class Intensity:
    """One source."""

    confidence: Confidence = "plug-in"  #: R by "plug-in" of the frame's covariance, from "residuals" of its blocks, or "none"
    blocks: int = 20  #: parts of a frame, for "residuals"

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → one direction each; the score is the share of the energy that flows."""
        return found(samples, flowing, self.confidence, self.blocks)


def flowing(C: Array) -> Solution:
    """Directions of c_vp of covariances (…, 4, 4)."""
    c = C[..., 1:, 0]
    length = np.linalg.norm(c, axis=-1, keepdims=True)
    heard = audible(C)[..., None]
    u = np.where(heard, c / np.where(heard, length, 1.0), np.array([1.0, 0.0, 0.0]))
    M = np.zeros((*C.shape[:-2], 2, 4, 4))
    M[..., 1:, 0] = axes(u) / np.where(heard, length, 1.0)[..., None]
    return Solution(u, symmetric(M))
