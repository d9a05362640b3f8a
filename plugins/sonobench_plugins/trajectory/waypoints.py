"""A walk from point to point, with stops."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from sonobench.types import Array, read_only


@dataclass(frozen=True, eq=False)
class Waypoints:
    """Straight legs between points, walked at one speed with stops, or so that each point is reached at a stated time."""

    points_m: Array  #: (k, 3) m, in order
    speed_m_s: float | None = None  #: on every leg; None: `times_s` says when
    pauses_s: Array = field(default_factory=lambda: np.zeros(0))  #: (k,) stop at each point, only with a speed; empty: no stops
    times_s: Array = field(
        default_factory=lambda: np.zeros(0)
    )  #: (k,) when each point is reached, from 0, increasing; only without a speed

    def __post_init__(self) -> None:
        points = read_only(self.points_m, shape=(None, 3), name="points_m")
        k = len(points)
        if k < 2:
            raise ValueError(f"points_m holds {k} point(s); two or more are needed (use 'still' for one)")
        if (self.speed_m_s is None) == (len(self.times_s) == 0):
            raise ValueError("either speed_m_s or times_s is needed, not both")
        if len(self.times_s):
            if len(self.times_s) != k or self.times_s[0] < 0 or not (np.diff(self.times_s) > 0).all():
                raise ValueError(f"times_s needs {k} increasing times from 0 on, one a point; got {np.asarray(self.times_s).tolist()}")
            if len(self.pauses_s):
                raise ValueError("pauses_s goes with speed_m_s; with times_s repeat the point instead")
        elif not 0 < self.speed_m_s < np.inf:  # type: ignore[operator]
            raise ValueError(f"speed_m_s is {self.speed_m_s}; a positive speed is needed")
        if len(self.pauses_s) and (len(self.pauses_s) != k or (np.asarray(self.pauses_s) < 0).any()):
            raise ValueError(f"pauses_s needs {k} stops of at least 0 s, one a point; got {np.asarray(self.pauses_s).tolist()}")
        object.__setattr__(self, "points_m", points)
        for name in ("pauses_s", "times_s"):
            object.__setattr__(self, name, read_only(getattr(self, name), shape=(None,), name=name))

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        when, where = self._schedule()
        return np.stack([np.interp(time_s, when, where[:, axis]) for axis in range(3)], axis=-1)

    def _schedule(self) -> tuple[Array, Array]:
        if self.speed_m_s is None:
            return self.times_s, self.points_m
        leg_s = np.linalg.norm(np.diff(self.points_m, axis=0), axis=1) / self.speed_m_s
        pause_s = self.pauses_s if len(self.pauses_s) else np.zeros(len(self.points_m))
        arrive = np.concatenate([[0.0], np.cumsum(leg_s + pause_s[:-1])])
        return np.stack([arrive, arrive + pause_s], axis=1).ravel(), np.repeat(self.points_m, 2, axis=0)
