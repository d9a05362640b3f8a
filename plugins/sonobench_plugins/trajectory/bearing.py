"""A motion of the direction in which a source is seen from a point, at a fixed range.

Azimuth and elevation begin at constant rates. From each segment's time on, the vector of their rates (azimuth, elevation) stays as it is, turns
at a rate of its own, or grows by an acceleration; direction and rates are continuous. Elevations beyond ±90° lead over the pole.
Source: the motion of Zhang et al., "Cum-AMMS-GLMB", section 5, without its random accelerations; the turn is the coordinated turn of Blackman &
Popoli 1999, "Design and analysis of modern tracking systems", taken in the plane of the two angles.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from sonobench.geometry import unit_vector
from sonobench.types import Array, read_only


@dataclass(frozen=True)
class Segment:
    """A stretch of one model: a turn, an acceleration, or neither."""

    from_s: float  #: time since the start
    turn_deg_s: float = 0.0  #: of the rate vector, from azimuth towards elevation
    azimuth_deg_s2: float = 0.0  #: acceleration
    elevation_deg_s2: float = 0.0  #: acceleration

    def __post_init__(self) -> None:
        values = (self.from_s, self.turn_deg_s, self.azimuth_deg_s2, self.elevation_deg_s2)
        if not all(map(math.isfinite, values)) or self.from_s < 0:
            raise ValueError(f"from_s, turn and accelerations are {list(values)}; finite numbers are needed, from_s of at least 0")
        if self.turn_deg_s and (self.azimuth_deg_s2 or self.elevation_deg_s2):
            raise ValueError(f"the segment from {self.from_s:g} s turns and accelerates; write one of both")


@dataclass(frozen=True, eq=False)
class Bearing:
    """Azimuth and elevation in segments of constant rates, turns and accelerations; then still."""

    range_m: float  #: distance from the origin
    azimuth_deg: float  #: at the start, counter-clockwise from +x
    elevation_deg: float  #: at the start, from the xy plane
    azimuth_deg_s: float = 0.0  #: at the start
    elevation_deg_s: float = 0.0  #: at the start
    segments: tuple[Segment, ...] = ()  #: what changes later, in order of time: tables of from_s and turn_deg_s or accelerations
    origin_m: Array = field(default_factory=lambda: np.zeros(3))  #: (3,) m, the point that it is seen from
    until_s: float = 600.0  #: how long it goes on

    def __post_init__(self) -> None:
        object.__setattr__(self, "origin_m", read_only(self.origin_m, shape=(3,), name="origin_m"))
        for name in ("range_m", "until_s"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed")
        angles = [self.azimuth_deg, self.elevation_deg, self.azimuth_deg_s, self.elevation_deg_s]
        if not all(map(math.isfinite, angles)):
            raise ValueError(f"azimuth, elevation and their rates are {angles}; finite numbers are needed")
        if abs(self.elevation_deg) > 90:
            raise ValueError(f"elevation_deg is {self.elevation_deg}; -90 to 90 at the start is needed")
        starts = [s.from_s for s in self.segments]
        if any(b <= a for a, b in itertools.pairwise(starts)):
            raise ValueError(f"segments begin at {starts} s; increasing times are needed")

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        return np.asarray(self.origin_m + self.range_m * unit_vector(np.deg2rad(self.angles_deg(time_s))))

    def angles_deg(self, time_s: Array) -> Array:
        """(k, 2) azimuth and elevation, degrees, not wrapped."""
        at = np.clip(np.asarray(time_s, float), 0.0, self.until_s)
        out = np.zeros((len(at), 2))
        where, rate = np.array([self.azimuth_deg, self.elevation_deg]), np.array([self.azimuth_deg_s, self.elevation_deg_s])
        edges = [0.0, *(s.from_s for s in self.segments), np.inf]
        for segment, (start, end) in zip((None, *self.segments), itertools.pairwise(edges), strict=True):
            mine = (at >= start) & (at < end)
            out[mine] = where + _way(segment, rate, at[mine] - start)
            if end < np.inf:
                where = where + _way(segment, rate, np.array([end - start]))[0]
                rate = _rate(segment, rate, end - start)
        return out


def _way(segment: Segment | None, rate: Array, time_s: Array) -> Array:
    """(k, 2) degrees gone after times (k,) that began at `rate` (2,): the integral of `_rate`."""
    t = time_s[:, None]
    if segment is None:
        return np.asarray(rate * t)
    if not segment.turn_deg_s:
        return np.asarray(rate * t + np.array([segment.azimuth_deg_s2, segment.elevation_deg_s2]) * t**2 / 2.0)
    turn = math.radians(segment.turn_deg_s)
    left = np.array([-rate[1], rate[0]])
    return np.asarray((rate * np.sin(turn * t) + left * (1.0 - np.cos(turn * t))) / turn)


def _rate(segment: Segment | None, rate: Array, time_s: float) -> Array:
    """(2,) degrees a second after a time."""
    if segment is None:
        return rate
    angle = math.radians(segment.turn_deg_s * time_s)
    turned = rate * math.cos(angle) + np.array([-rate[1], rate[0]]) * math.sin(angle)
    return np.asarray(turned + np.array([segment.azimuth_deg_s2, segment.elevation_deg_s2]) * time_s)
