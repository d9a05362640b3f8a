"""A walk along a horizontal circle at constant speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.types import Array, read_only


@dataclass(frozen=True, eq=False)
class Arc:
    """Part of a horizontal circle, then still."""

    centre_m: Array  #: (3,) m
    radius_m: float  #: of the circle
    start_deg: float  #: azimuth of the start, counter-clockwise from +x
    speed_m_s: float  #: along the circle
    sweep_deg: float = 180.0  #: angle walked in all (not negative)
    clockwise: bool = False  #: seen from above

    def __post_init__(self) -> None:
        object.__setattr__(self, "centre_m", read_only(self.centre_m, shape=(3,), name="centre_m"))
        for name in ("radius_m", "speed_m_s", "sweep_deg"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed (the direction is 'clockwise')")

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        walked = np.clip(np.asarray(time_s) * self.speed_m_s / self.radius_m, 0.0, np.deg2rad(self.sweep_deg))
        angle = np.deg2rad(self.start_deg) + (-walked if self.clockwise else walked)
        circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
        return np.asarray(self.centre_m + self.radius_m * circle)
