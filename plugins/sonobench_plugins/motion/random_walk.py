"""Random walk: the position alone, which a Gaussian step moves; its variance grows with the time that passed.

With `adaptive` the step follows the target: after an update by d over dt the walk's variance per second, d² / dt over the coordinates, is
averaged into it, within limits. This stands in for the adaptive random walk that a paper of 2022 (multi-feature adaptive unscented
particle filter, its MFARW) takes from elsewhere without printing it.
Source: Ward, Lehmann & Williamson 2003, "Particle filtering algorithms for tracking an acoustic source in a reverberant environment".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.filtering.kinematics import linear_log_density, linear_moments, linear_sample
from sonobench.protocols import State
from sonobench.types import Array, Ints, Space


@dataclass(frozen=True)
class RandomWalk:
    """Positions x_m y_m [z_m] that walk; the memory is the walk's variance a second, None for the parameter's."""

    dims: int = 2  #: 2 or 3
    walk_m: float = 0.5  #: standard deviation that a coordinate gains in one second
    adaptive: bool = False  #: whether the walk follows what updates move
    limits_m: tuple[float, float] = (0.1, 2.0)  #: least and greatest walk, when adaptive
    memory_s: float = 0.5  #: time constant of what is averaged, when adaptive

    def __post_init__(self) -> None:
        if self.dims not in (2, 3):
            raise ValueError(f"dims is {self.dims}; a motion model moves in 2 or 3 dimensions")
        if not (self.walk_m >= 0 and self.memory_s > 0 and 0 <= self.limits_m[0] <= self.limits_m[1]):
            raise ValueError(
                f"walk_m is {self.walk_m}, memory_s {self.memory_s}, limits_m {self.limits_m}; walks of at least 0 in order are needed"
            )

    @property
    def space(self) -> Space:
        """Positions."""
        return Space.of(*("x_m", "y_m", "z_m")[: self.dims])

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def matrices(self, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """F and Q (d, d) over dt_s."""
        variance = self.walk_m**2 if memory is None else float(memory)
        return np.eye(self.dims), np.eye(self.dims) * variance * dt_s

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
        """The variance a second after an update from prior (d,) to posterior (d,)."""
        if not self.adaptive or dt_s <= 0:
            return memory
        before = self.walk_m**2 if memory is None else float(memory)
        kept = float(np.exp(-dt_s / self.memory_s))
        seen = float(np.mean((posterior - prior) ** 2)) / dt_s
        return float(np.clip(kept * before + (1 - kept) * seen, self.limits_m[0] ** 2, self.limits_m[1] ** 2))
