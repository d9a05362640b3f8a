"""Directions at nearly constant rates: the rates of azimuth and elevation do a random walk.

Q = q [[T³/3, T²/2], [T²/2, T]] per angle, so that two steps of T/2 are one of T. `accelerations` adds the coordinates that other
models of an `imm` need: here they move nothing and are drawn anew in every step, N(0, a²), which is what a model that does use
them then begins with.
Source: Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 6.2.2; Li & Jilkov 2003,
"Survey of maneuvering target tracking. Part I", section III; Zhang et al., "Cum-AMMS-GLMB", eq. 1.
Deviations: the paper holds an acceleration of .5 °/s² over each step of 1 s, which leaves Q singular; here it is white.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.filtering.bearings import bearing_log_density, bearing_moments, bearing_sample, bearing_space, blocks, held_still
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space


@dataclass(frozen=True)
class BearingVelocity:
    """Constant rates, state order azimuth_rad azimuth_rad_s elevation_rad elevation_rad_s (accelerations after each rate where wanted)."""

    rate_walk_deg_s: float = 0.5  #: standard deviation that each rate gains in one second, √q
    accelerations: bool = False  #: carry accelerations, so that it can stand in an imm beside models that need them
    acceleration_deg_s2: float = 0.05  #: deviation a of accelerations, where they are carried

    def __post_init__(self) -> None:
        for name in ("rate_walk_deg_s", "acceleration_deg_s2"):
            if not 0 <= getattr(self, name) < math.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; at least 0 is needed")

    @property
    def space(self) -> Space:
        """Angles and rates, with accelerations where wanted."""
        return bearing_space(self.accelerations)

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def matrices(self, dt_s: float) -> tuple[Array, Array]:
        """F and Q (d, d) over dt_s in rad; identity and zero at dt_s = 0."""
        T = dt_s
        F = np.array([[1.0, T], [0.0, 1.0]])
        Q = math.radians(self.rate_walk_deg_s) ** 2 * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
        if self.accelerations:
            F, Q = np.pad(F, (0, 1)), np.pad(Q, (0, 1))
            Q[2, 2] = math.radians(self.acceleration_deg_s2) ** 2
        return held_still(blocks(F), blocks(Q), dt_s)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances, angles in range."""
        return bearing_moments(x, P, *self.matrices(dt_s))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles, angles in range."""
        return bearing_sample(rng, x, *self.matrices(dt_s)), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,)."""
        return bearing_log_density(x1, x0, *self.matrices(dt_s))
