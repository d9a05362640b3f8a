"""Directions at nearly constant accelerations: the accelerations of azimuth and elevation do a random walk.

Q = q [[T⁵/20, T⁴/8, T³/6], [T⁴/8, T³/3, T²/2], [T³/6, T²/2, T]] per angle.
Source: Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 6.2.3.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.filtering.bearings import bearing_log_density, bearing_moments, bearing_sample, bearing_space, blocks, held_still
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space


@dataclass(frozen=True)
class BearingAcceleration:
    """Constant accelerations, state order azimuth_rad azimuth_rad_s azimuth_rad_s2 elevation_rad elevation_rad_s elevation_rad_s2."""

    acceleration_walk_deg_s2: float = 0.1  #: standard deviation that each acceleration gains in one second, √q

    def __post_init__(self) -> None:
        if not 0 <= self.acceleration_walk_deg_s2 < math.inf:
            raise ValueError(f"acceleration_walk_deg_s2 is {self.acceleration_walk_deg_s2}; at least 0 is needed")

    @property
    def space(self) -> Space:
        """Angles, rates and accelerations."""
        return bearing_space(True)

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def matrices(self, dt_s: float) -> tuple[Array, Array]:
        """F and Q (6, 6) over dt_s in rad; identity and zero at dt_s = 0."""
        T = dt_s
        F = np.array([[1.0, T, T**2 / 2], [0.0, 1.0, T], [0.0, 0.0, 1.0]])
        Q = np.array([[T**5 / 20, T**4 / 8, T**3 / 6], [T**4 / 8, T**3 / 3, T**2 / 2], [T**3 / 6, T**2 / 2, T]])
        return held_still(blocks(F), math.radians(self.acceleration_walk_deg_s2) ** 2 * blocks(Q), dt_s)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances, angles in range."""
        return bearing_moments(x, P, *self.matrices(dt_s))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles, angles in range."""
        return bearing_sample(rng, x, *self.matrices(dt_s)), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,)."""
        return bearing_log_density(x1, x0, *self.matrices(dt_s))
