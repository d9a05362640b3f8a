"""Nearly constant velocity: acceleration is white noise in continuous time, or a random constant over each step.

In continuous time Q = q [[T³/3, T²/2], [T²/2, T]] per axis, so that two steps of T/2 are one of T: right for irregular scans.
Held over a step, as many papers have it, Q = a² G Gᵀ with G = [T²/2; T], of rank one; its strength depends on where scans fall.
Source: Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", sections 6.2.2 and 6.3.2;
Li & Jilkov 2003, "Survey of maneuvering target tracking. Part I", section III.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.filtering.kinematics import kinematic_space, linear_log_density, linear_moments, linear_sample, per_axis
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space


@dataclass(frozen=True)
class ConstantVelocity:
    """Constant velocity in state order x_m vx_m_s y_m vy_m_s [z_m vz_m_s]."""

    dims: int = 2  #: 2 or 3
    velocity_walk_m_s: float = 0.5  #: standard deviation that an axis's velocity gains in one second, √q
    held_acceleration_m_s2: float | None = None  #: deviation a of an acceleration held over each step, in place of √q; None: √q

    def __post_init__(self) -> None:
        kinematic_space(self.dims)
        if not self.velocity_walk_m_s >= 0:
            raise ValueError(f"velocity_walk_m_s is {self.velocity_walk_m_s}; at least 0 is needed")
        if self.held_acceleration_m_s2 is not None and not self.held_acceleration_m_s2 >= 0:
            raise ValueError(f"held_acceleration_m_s2 is {self.held_acceleration_m_s2}; at least 0 is needed")

    @property
    def space(self) -> Space:
        """Positions and velocities."""
        return kinematic_space(self.dims)

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def matrices(self, dt_s: float) -> tuple[Array, Array]:
        """F and Q (d, d) over dt_s; identity and zero at dt_s = 0."""
        T = dt_s
        if self.held_acceleration_m_s2 is None:
            Q = self.velocity_walk_m_s**2 * np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
        else:
            Q = self.held_acceleration_m_s2**2 * np.outer([T**2 / 2, T], [T**2 / 2, T])
        return per_axis(np.array([[1.0, T], [0.0, 1.0]]), self.dims), per_axis(Q, self.dims)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances."""
        return linear_moments(x, P, *self.matrices(dt_s))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles."""
        return linear_sample(rng, x, *self.matrices(dt_s)), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,); −inf off the support of a degenerate Q: unless x1 = x0 moved straight on where the noise or dt_s is 0."""
        return linear_log_density(x1, x0, *self.matrices(dt_s))
