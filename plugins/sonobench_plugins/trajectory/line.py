"""A straight walk at constant speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.types import Array, read_only


@dataclass(frozen=True, eq=False)
class Line:
    """From one point to another, then still."""

    from_m: Array  #: (3,) m, where it starts
    to_m: Array  #: (3,) m, where it stops
    speed_m_s: float  #: along the line

    def __post_init__(self) -> None:
        for name in ("from_m", "to_m"):
            object.__setattr__(self, name, read_only(getattr(self, name), shape=(3,), name=name))
        if not 0 < self.speed_m_s < np.inf:
            raise ValueError(f"speed_m_s is {self.speed_m_s}; a positive speed is needed (use 'still' for a source that stays)")
        if not np.linalg.norm(self.to_m - self.from_m):
            raise ValueError("from_m and to_m are the same point; use 'still'")

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        way = self.to_m - self.from_m
        share = np.clip(np.asarray(time_s) * self.speed_m_s / np.linalg.norm(way), 0.0, 1.0)
        return np.asarray(self.from_m + share[:, None] * way)
