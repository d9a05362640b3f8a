"""Langevin motion: each axis's velocity decays towards zero and is kicked at random.

v' = a v + b F, x' = x + T v', a = exp(−beta T), b = v_rms √(1 − a²), F ~ N(0, 1).
Source: Vermaak & Blake 2001, "Nonlinear filtering for speaker tracking in noisy and reverberant environments"; as in
Chen, Chen, Yin & Hou 2012, eq. 36 and 37.
Deviations: that paper prints Q = diag(b² T², b²) per axis, which drops the correlation of position and velocity that its
own eq. 36 implies. The default is the exact, rank-one b² [[T², T], [T, 1]]; `noise = "diagonal"` is the printed one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.filtering.kinematics import kinematic_space, linear_log_density, linear_moments, linear_sample, per_axis
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space


@dataclass(frozen=True)
class Langevin:
    """Langevin motion in state order x_m vx_m_s y_m vy_m_s [z_m vz_m_s]."""

    dims: int = 2  #: 2 or 3
    rate_hz: float = 10.0  #: beta, the rate at which a velocity is forgotten
    v_rms_m_s: float = 1.0  #: steady-state root-mean-square velocity of an axis
    noise: Literal["exact", "diagonal"] = "exact"  #: "diagonal" is the Q printed by Chen et al. 2012

    def __post_init__(self) -> None:
        kinematic_space(self.dims)
        if not (self.rate_hz > 0 and self.v_rms_m_s >= 0):
            raise ValueError(f"rate_hz is {self.rate_hz} and v_rms_m_s {self.v_rms_m_s}; above 0 and at least 0 are needed")
        if self.noise not in ("exact", "diagonal"):
            raise ValueError(f"noise is {self.noise!r}; 'exact' or 'diagonal' is needed")

    @property
    def space(self) -> Space:
        """Positions and velocities."""
        return kinematic_space(self.dims)

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def matrices(self, dt_s: float) -> tuple[Array, Array]:
        """F and Q (d, d) over dt_s (eq. 37); identity and zero at dt_s = 0."""
        T, a = dt_s, math.exp(-self.rate_hz * dt_s)
        b2 = self.v_rms_m_s**2 * -math.expm1(-2 * self.rate_hz * dt_s)
        Q = b2 * np.array([[T * T, T], [T, 1.0]])
        if self.noise == "diagonal":
            Q = np.diag(np.diag(Q))
        return per_axis(np.array([[1.0, T * a], [0.0, a]]), self.dims), per_axis(Q, self.dims)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances."""
        return linear_moments(x, P, *self.matrices(dt_s))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles."""
        return linear_sample(rng, x, *self.matrices(dt_s)), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,).

        The exact noise has rank one per axis: the density is then the one on its support (Lebesgue measure along the
        kicks), and −inf where x1 is not x0 moved by its own new velocity.
        """
        return linear_log_density(x1, x0, *self.matrices(dt_s))
