"""Langevin motion whose steady speed follows the target's own.

After an update the speed of an axis, √(v² / axes) of the estimate, is averaged into v_rms, within limits. This stands in for the adaptive
Langevin model that a paper of 2022 (multi-feature adaptive unscented particle filter, its MFAL) takes from elsewhere without printing it.
Source: Vermaak & Blake 2001 for the motion; see `langevin`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sonobench.protocols import State
from sonobench.types import Array, Ints, Space
from sonobench_plugins.motion.langevin import Langevin


@dataclass(frozen=True)
class AdaptiveLangevin:
    """Langevin motion; the memory is v_rms_m_s, None for that of `start`."""

    start: Langevin = field(default_factory=Langevin)  #: the motion before anything is known
    limits_m_s: tuple[float, float] = (0.2, 2.0)  #: least and greatest v_rms_m_s
    memory_s: float = 0.5  #: time constant of what is averaged

    def __post_init__(self) -> None:
        if not (0 <= self.limits_m_s[0] <= self.limits_m_s[1] and self.memory_s > 0):
            raise ValueError(f"limits_m_s is {self.limits_m_s} and memory_s {self.memory_s}; speeds in order and a time above 0 are needed")

    @property
    def space(self) -> Space:
        """Positions and velocities."""
        return self.start.space

    @property
    def n_modes(self) -> int:
        """One."""
        return 1

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Predicted means and covariances."""
        return self._now(memory).moments(x, P, mode, dt_s)

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Next particles."""
        return self._now(memory).sample(rng, x, mode, dt_s)

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log p(x1 | x0) (n,), as `Langevin` has it."""
        return self._now(memory).log_density(x1, x0, mode, dt_s)

    def adapt(self, memory: State, prior: Array, posterior: Array, dt_s: float) -> State:
        """v_rms_m_s after an update from prior (d,) to posterior (d,)."""
        before = self.start.v_rms_m_s if memory is None else float(memory)
        speed = float(np.sqrt(np.mean(np.asarray(posterior)[1::2] ** 2)))
        kept = float(np.exp(-dt_s / self.memory_s))
        return float(np.clip(kept * before + (1 - kept) * speed, *self.limits_m_s))

    def _now(self, memory: State) -> Langevin:
        return self.start if memory is None else replace(self.start, v_rms_m_s=float(memory))
