"""Directions that turn at a known rate: the velocity (azimuth, elevation) rotates like one in a plane, and does a random walk beside.

Two of them with opposite rates stand for turns either way in an `imm`. With `accelerations` as in `bearing-velocity`.
Source: Bar-Shalom, Li & Kirubarajan 2001, "Estimation with applications to tracking and navigation", section 11.7.1 (known turn rate);
Zhang et al., "Cum-AMMS-GLMB", the model "CT".
Deviations: Q is that of a straight way, which is right to the first order in the angle turned within a step.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.filtering.bearings import bearing_log_density, bearing_moments, bearing_sample, bearing_space, held_still
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space
from sonobench_plugins.motion.bearing_velocity import BearingVelocity


@dataclass(frozen=True)
class BearingTurn:
    """Coordinated turn in the plane of the angles, states as of `bearing-velocity`; counter-clockwise from azimuth to elevation."""

    turn_deg_s: float = 2.0  #: rate at which the velocity turns
    rate_walk_deg_s: float = 0.5  #: standard deviation that each rate gains in one second besides
    accelerations: bool = False  #: carry accelerations, so that it can stand in an imm beside models that need them
    acceleration_deg_s2: float = 0.05  #: deviation of accelerations, where they are carried

    def __post_init__(self) -> None:
        if not math.isfinite(self.turn_deg_s):
            raise ValueError(f"turn_deg_s is {self.turn_deg_s}; a finite rate is needed")
        self._straight()

    def _straight(self) -> BearingVelocity:
        return BearingVelocity(self.rate_walk_deg_s, self.accelerations, self.acceleration_deg_s2)

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
        F, Q = (np.array(a) for a in self._straight().matrices(dt_s))
        n = len(F) // 2
        angle = math.radians(self.turn_deg_s) * dt_s
        ahead = dt_s * np.sinc(angle / math.pi)
        aside = dt_s * angle / 2 * np.sinc(angle / (2 * math.pi)) ** 2
        c, s = math.cos(angle), math.sin(angle)
        rates = [1, n + 1]
        F[np.ix_(rates, rates)] = [[c, -s], [s, c]]
        F[np.ix_([0, n], rates)] = [[ahead, -aside], [aside, ahead]]
        return held_still(F, Q, dt_s)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances, angles in range."""
        return bearing_moments(x, P, *self.matrices(dt_s))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles, angles in range."""
        return bearing_sample(rng, x, *self.matrices(dt_s)), mode

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,)."""
        return bearing_log_density(x1, x0, *self.matrices(dt_s))
