"""Constant velocity whose noise follows how far updates correct the velocity, axis by axis.

What an update adds to a velocity, Δv over dt, is an acceleration that the model did not foresee: white acceleration of density
q = (C Δv)² / dt would explain it. q is averaged over time and kept within limits.
Source: "Multi-feature adaptive unscented particle filter" (in Chinese; Chinese Journal of Scientific Instrument 43, 2022), eq. 31.
Deviations: eq. 31 takes C |Δv| / dt, an acceleration, as the variance of positions and of velocities at once, diag(q, q), whatever the
period: `noise = "printed"`. There is no limit in it either, and no average; without a lower one the noise dies out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.filtering.kinematics import kinematic_space, linear_log_density, linear_moments, linear_sample
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space


@dataclass(frozen=True)
class AdaptiveConstantVelocity:
    """States x_m vx_m_s y_m vy_m_s [z_m vz_m_s]; the memory is q (dims,), None before the first update."""

    dims: int = 2  #: 2 or 3
    velocity_walk_m_s: float = 1.0  #: deviation that an axis's velocity gains in one second, √q, before anything is known
    limits_m_s: tuple[float, float] = (0.5, 2.0)  #: least and greatest of it
    gain: float = 1.0  #: C
    memory_s: float = 0.25  #: time constant of the average, 0 for none
    noise: Literal["white", "printed"] = "white"  #: "printed": q on the diagonal, for positions and velocities alike

    def __post_init__(self) -> None:
        kinematic_space(self.dims)
        if self.noise not in ("white", "printed"):
            raise ValueError(f"noise is {self.noise!r}; 'white' or 'printed' is needed")
        if not (self.velocity_walk_m_s >= 0 and 0 <= self.limits_m_s[0] <= self.limits_m_s[1] and self.gain >= 0 and self.memory_s >= 0):
            raise ValueError(
                f"velocity_walk_m_s is {self.velocity_walk_m_s}, limits_m_s {self.limits_m_s}, gain {self.gain}, memory_s {self.memory_s}; "
                "at least 0, and limits in order, are needed"
            )

    @property
    def space(self) -> Space:
        """Positions and velocities."""
        return kinematic_space(self.dims)

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def matrices(self, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """F and Q (d, d) over dt_s."""
        q = np.full(self.dims, self.velocity_walk_m_s**2) if memory is None else np.asarray(memory)
        T, axes = dt_s, np.eye(self.dims)
        F = np.kron(axes, np.array([[1.0, T], [0.0, 1.0]]))
        block = np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]]) if self.noise == "white" else np.eye(2) * float(T > 0)
        return F, np.kron(np.diag(q), block)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances."""
        return linear_moments(x, P, *self.matrices(dt_s, memory))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles."""
        return linear_sample(rng, x, *self.matrices(dt_s, memory)), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,)."""
        return linear_log_density(x1, x0, *self.matrices(dt_s, memory))

    def adapt(self, memory: State, prior: Array, posterior: Array, dt_s: float) -> State:
        """q (dims,) after an update from prior (d,) to posterior (d,)."""
        if dt_s <= 0:
            return memory
        low, high = self.limits_m_s[0] ** 2, self.limits_m_s[1] ** 2
        gained = self.gain * np.abs(np.asarray(posterior)[1::2] - np.asarray(prior)[1::2])
        seen = gained**2 / dt_s if self.noise == "white" else gained / dt_s
        before = np.full(self.dims, self.velocity_walk_m_s**2) if memory is None else np.asarray(memory)
        kept = float(np.exp(-dt_s / self.memory_s)) if self.memory_s > 0 else 0.0
        return np.clip(kept * before + (1 - kept) * seen, low, high)
