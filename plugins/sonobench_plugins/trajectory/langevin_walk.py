"""A Langevin walk within a box, the same for the same seed: the source path of Liang 2016.

Each axis's velocity is a stationary Ornstein-Uhlenbeck process, drawn exactly at multiples of `step_s`: v' = a v + v_rms √(1 − a²) F, a = exp(−beta step),
F ~ N(0, 1). Between, it runs straight, and the position is its integral; at the walls of the box the walk is mirrored, so it never leaves.
Source: Vermaak & Blake 2001, "Nonlinear filtering for speaker tracking in noisy and reverberant environments"; Liang 2016, 5.3 (beta 10 s⁻¹, 1 m/s).
Deviations: they put x' = x + T v', whose walk depends on the frame T; here it depends on `step_s` only where that is not small against 1 / beta.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.scene.walks import checked_box, draws, mirrored
from sonobench.types import Array


@dataclass(frozen=True, eq=False)
class LangevinWalk:
    """A walk from a point, at its height, at a random velocity that is forgotten and renewed; then still."""

    seed: int  #: another seed is another walk
    start_m: Array  #: (3,) m, where it starts
    low_m: Array  #: (2,) m, corner of the box on the floor
    high_m: Array  #: (2,) m, the opposite corner
    rate_hz: float = 10.0  #: beta, the rate at which a velocity is forgotten
    v_rms_m_s: float = 1.0  #: root-mean-square velocity of an axis
    until_s: float = 60.0  #: how long it goes on
    step_s: float = 0.01  #: between the velocities that are drawn

    def __post_init__(self) -> None:
        for name, value in zip(("start_m", "low_m", "high_m"), checked_box(self.start_m, self.low_m, self.high_m), strict=True):
            object.__setattr__(self, name, value)
        for name in ("rate_hz", "v_rms_m_s", "until_s", "step_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; 0 or more is needed")

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        at = np.clip(np.asarray(time_s, float), 0.0, self.until_s) / self.step_s
        velocity = self._velocities(int(at.max(initial=0.0)) + 2)
        strides = self.step_s * (velocity[:-1] + velocity[1:]) / 2.0
        knots = self.start_m[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(strides, axis=0)])
        k = at.astype(np.int64)
        u = (at - k)[:, None]
        floor = knots[k] + self.step_s * (u * velocity[k] + u**2 / 2.0 * (velocity[k + 1] - velocity[k]))
        return np.column_stack([mirrored(floor, self.low_m, self.high_m), np.full(len(floor), self.start_m[2])])

    def _velocities(self, n: int) -> Array:
        """(n, 2) m/s on the endless floor, the first drawn from the stationary law."""
        from scipy.signal import lfilter

        a = math.exp(-self.rate_hz * self.step_s)
        kicks = draws(self.seed, n)
        kicks[1:] *= math.sqrt(-math.expm1(-2.0 * self.rate_hz * self.step_s))
        return np.asarray(self.v_rms_m_s * lfilter([1.0], [1.0, -a], kicks, axis=0))
