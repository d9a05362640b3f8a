"""A random walk within a box, the same for the same seed.

Every `step_s` a stride is drawn, independent of all before: Gaussian, `spread_m` √step_s along each axis, walked straight and at one speed. So after t seconds the
walk has spread by spread_m √t whatever the step, while its speed, spread_m / √step_s along each axis (root mean square), does depend on it.
At the walls of the box the walk is mirrored, so it never leaves.
Source: Einstein 1905 for the law; as a talker's motion in Ward, Lehmann & Williamson 2003, "Particle filtering algorithms for tracking an acoustic source".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.scene.walks import checked_box, draws, mirrored
from sonobench.types import Array


@dataclass(frozen=True, eq=False)
class RandomWalk:
    """Strides from a point, at its height; then still."""

    seed: int  #: another seed is another walk
    start_m: Array  #: (3,) m, where it starts
    low_m: Array  #: (2,) m, corner of the box on the floor
    high_m: Array  #: (2,) m, the opposite corner
    spread_m: float = 0.3  #: standard deviation along each axis after one second, without walls
    until_s: float = 60.0  #: how long it goes on
    step_s: float = 0.5  #: time of a stride

    def __post_init__(self) -> None:
        for name, value in zip(("start_m", "low_m", "high_m"), checked_box(self.start_m, self.low_m, self.high_m), strict=True):
            object.__setattr__(self, name, value)
        for name in ("spread_m", "until_s", "step_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed")
        if self.seed < 0:
            raise ValueError(f"seed is {self.seed}; 0 or more is needed")

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        at = np.clip(np.asarray(time_s, float), 0.0, self.until_s) / self.step_s
        strides = self.spread_m * math.sqrt(self.step_s) * draws(self.seed, int(at.max(initial=0.0)) + 1)
        knots = self.start_m[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(strides, axis=0)])
        k = at.astype(np.int64)
        floor = knots[k] + (at - k)[:, None] * strides[k]
        return np.column_stack([mirrored(floor, self.low_m, self.high_m), np.full(len(floor), self.start_m[2])])
