"""Nearly coordinated turn: whoever walks turns at a rate that is part of the state and fades towards none.

The velocity turns at the rate omega while position follows it exactly, omega being held over a step; then white
accelerations act along and across the way, and omega becomes a omega + s √(1 − a²) N(0, 1), a = exp(−T / tau): a rate of
deviation s that is forgotten within about tau. With s = 0 and omega = 0 it is nearly constant velocity.
Source: Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 11.7; Li &
Jilkov 2003, "Survey of maneuvering target tracking. Part I", section V-B (unknown turn rate, first-order Markov). Gaussians
go through the turn by cubature (Arasaratnam & Haykin 2009).
Deviations: the noise of a Gaussian takes its directions from the mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.filtering.gaussian import log_degenerate, root, symmetric
from sonobench.filtering.kinematics import kinematic_space
from sonobench.filtering.points import spread
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space

_VX, _VY, _TURN = 1, 3, 4


@dataclass(frozen=True)
class CoordinatedTurn:
    """Coordinated turn in the plane, state order x_m vx_m_s y_m vy_m_s turn_rad_s."""

    turn_std_rad_s: float = 1.0  #: steady-state deviation of the turn rate
    turn_time_s: float = 1.0  #: time within which a turn rate is forgotten
    along_walk_m_s: float = 0.1  #: deviation that the velocity gains in one second along the way
    across_walk_m_s: float = 0.1  #: and across it, beyond what turning gives

    def __post_init__(self) -> None:
        for name in ("turn_std_rad_s", "along_walk_m_s", "across_walk_m_s"):
            if not 0 <= getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; at least 0 is needed")
        if not self.turn_time_s > 0:
            raise ValueError(f"turn_time_s is {self.turn_time_s}; above 0 is needed (inf: a turn rate is never forgotten)")

    @property
    def space(self) -> Space:
        """Positions, velocities, turn rate (counter-clockwise)."""
        return Space.of(*kinematic_space(2).names, "turn_rad_s")

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances; unchanged at dt_s = 0."""
        if dt_s == 0 or len(x) == 0:
            return x, P
        images = self._turned(spread(x, P, math.sqrt(x.shape[-1])), dt_s)
        m = images.mean(axis=-2)
        off = images - m[:, None]
        return m, symmetric(np.swapaxes(off, -1, -2) @ off / images.shape[-2] + self._noise(x, dt_s))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles."""
        kicks = (root(self._noise(x, dt_s)) @ rng.standard_normal((*x.shape, 1)))[..., 0]
        return np.asarray(self._turned(x, dt_s) + kicks), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,); −inf off the support where a noise or dt_s is 0."""
        residual, Q = x1 - self._turned(x0, dt_s), self._noise(x0, dt_s)
        magnitude = np.max(np.abs(x1), axis=-1, initial=0.0) + np.max(np.abs(x0), axis=-1, initial=0.0)
        parts = [log_degenerate(residual[i : i + 1], Q[i], magnitude[i : i + 1]) for i in range(len(x1))]
        return np.concatenate(parts) if parts else np.zeros(0)

    def _turned(self, x: Array, dt_s: float) -> Array:
        """States (…, 5) after dt_s without noise; the chord of the turn is sinc-shaped, so that no rate divides by zero."""
        px, vx, py, vy, turn = np.moveaxis(x, -1, 0)
        angle = turn * dt_s
        ahead = dt_s * np.sinc(angle / math.pi)
        aside = dt_s * angle / 2 * np.sinc(angle / (2 * math.pi)) ** 2
        c, s = np.cos(angle), np.sin(angle)
        moved = (px + ahead * vx - aside * vy, c * vx - s * vy, py + aside * vx + ahead * vy, s * vx + c * vy)
        return np.stack([*moved, turn * math.exp(-dt_s / self.turn_time_s)], axis=-1)

    def _noise(self, x: Array, dt_s: float) -> Array:
        """Q (…, 5, 5): accelerations along and across the velocity (any direction, at rest along x), and the turn's kick."""
        T = dt_s
        velocity = x[..., [_VX, _VY]]
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        ahead = np.where(speed > 0, velocity / np.where(speed > 0, speed, 1.0), [1.0, 0.0])
        outer = ahead[..., :, None] * ahead[..., None, :]
        power = self.along_walk_m_s**2 * outer + self.across_walk_m_s**2 * (np.eye(2) - outer)
        block = np.array([[T**3 / 3, T**2 / 2], [T**2 / 2, T]])
        Q = np.zeros((*x.shape[:-1], 5, 5))
        Q[..., :_TURN, :_TURN] = (power[..., :, None, :, None] * block[:, None, :]).reshape(*x.shape[:-1], 4, 4)
        Q[..., _TURN, _TURN] = self.turn_std_rad_s**2 * -math.expm1(-2 * T / self.turn_time_s)
        return Q
