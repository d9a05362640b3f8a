"""A smooth random walk within a box at constant speed, the same for the same seed.

A uniform cubic B-spline over random control points on the floor: one leg of `leg_m` after the other, each turned from the
last by at most `turn_deg`. A spline stays within the convex hull of its control points, hence within the box that they
are drawn in. A turn is kept only where some legs straight on and then turning for ever to one side would stay within the box, so
a way on always exists. The curve is walked by its own length, so position and velocity are continuous and the speed is exact.
Source: de Boor 1978, "A practical guide to splines", for B-splines; the walk itself is ours.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.types import Array, read_only

_TRIES = 20  # turns drawn before the one that is known to fit
_NEWTON = 6  # steps from a chord's share to a length along the curve; four reach rounding
_BASIS = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0  # powers of u × control points
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)


@dataclass(frozen=True, eq=False)
class Wander:
    """A walk from a point and heading, at the start's height, then still."""

    seed: int  #: another seed is another walk
    start_m: Array  #: (3,) m, where it starts
    heading_deg: float  #: direction at the start, counter-clockwise from +x
    speed_m_s: float  #: along the walk
    low_m: Array  #: (2,) m, corner of the box on the floor
    high_m: Array  #: (2,) m, the opposite corner
    until_s: float = 60.0  #: how long it goes on
    leg_m: float = 0.4  #: distance between control points
    turn_deg: float = 45.0  #: largest turn from one leg to the next, below 90

    def __post_init__(self) -> None:
        for name, n in (("start_m", 3), ("low_m", 2), ("high_m", 2)):
            object.__setattr__(self, name, read_only(getattr(self, name), shape=(n,), name=name))
        for name in ("speed_m_s", "until_s", "leg_m"):
            if not 0 < getattr(self, name) < np.inf:
                raise ValueError(f"{name} is {getattr(self, name)}; a positive number is needed")
        if not 0 < self.turn_deg < 90:
            raise ValueError(f"turn_deg is {self.turn_deg}; between 0 and 90 is needed")
        if not (self.seed >= 0 and math.isfinite(self.heading_deg)):
            raise ValueError(f"seed is {self.seed} and heading_deg {self.heading_deg}; a seed of at least 0 and a finite angle are needed")
        first = self._first()
        if not (self._inside(first).all() and self._way_on(first[-1], math.radians(self.heading_deg)) is not None):
            raise ValueError(
                f"a walk from {self.start_m[:2].tolist()} towards {self.heading_deg} degrees cannot stay within {self.low_m.tolist()} to "
                f"{self.high_m.tolist()}: turning takes a circle of radius {self._radius_m():.2f} m to the left or right; move the start "
                "inwards, turn it, shorten leg_m or raise turn_deg"
            )

    def position(self, time_s: Array) -> Array:
        """(k, 3) m at times (k,) since the start."""
        walked = np.clip(np.asarray(time_s, float), 0.0, self.until_s) * self.speed_m_s
        points = self._control_points(float(walked.max(initial=0.0)))
        pieces = np.stack([points[i : len(points) - 3 + i] for i in range(4)], axis=1)  # (n, 4, 2)
        powers = _BASIS @ pieces  # (n, 4, 2): coefficients of 1, u, u², u³
        ends = np.cumsum(_length(powers, np.ones(len(powers))))
        n = np.minimum(np.searchsorted(ends, walked, side="right"), len(ends) - 1)
        own, rest = powers[n], walked - np.concatenate([[0.0], ends])[n]
        u = rest / np.diff(ends, prepend=0.0)[n]
        for _ in range(_NEWTON):
            u = np.clip(u - (_length(own, u) - rest) / np.linalg.norm(_slope(own, u), axis=-1), 0.0, 1.0)
        floor = np.einsum("kp,kpa->ka", u[:, None] ** np.arange(4), own)
        return np.column_stack([floor, np.full(len(floor), self.start_m[2])])

    def _first(self) -> Array:
        """(3, 2) control points that put the start at the start, moving along the heading."""
        ahead = self.leg_m * _unit(math.radians(self.heading_deg))
        return np.asarray(self.start_m[:2] + np.array([[-1.0], [0.0], [1.0]]) * ahead)

    def _control_points(self, length_m: float) -> Array:
        """(n, 2); more of them for a longer walk, never others."""
        rng = np.random.default_rng(self.seed)
        points, heading = list(self._first()), math.radians(self.heading_deg)
        shortest = self.leg_m * math.cos(math.radians(self.turn_deg))  # of a curve's piece: its slope's part along the middle leg
        for _ in range(int(length_m / shortest) + 2):
            heading = self._next(rng, points[-1], heading)
            points.append(points[-1] + self.leg_m * _unit(heading))
        return np.array(points)

    def _next(self, rng: np.random.Generator, point: Array, heading: float) -> float:
        """The next leg's heading (rad): a random turn after which the walk can go on, else one along a circle that fits."""
        most = math.radians(self.turn_deg)
        for turn in rng.uniform(-most, most, _TRIES):
            end = point + self.leg_m * _unit(heading + turn)
            if self._way_on(end, heading + turn) is not None:
                return heading + float(turn)
        return heading + (self._way_on(point, heading) or 0.0)

    def _way_on(self, point: Array, heading: float) -> float | None:
        """The turn (rad: none, or the largest to the left or right) of a way on for ever after a leg that ends here, None without one."""
        most = math.radians(self.turn_deg)
        radius_m, at = self._radius_m(), point
        while self._inside(at):
            for turn in (most, -most):
                centre = at + radius_m * _unit(heading + turn / 2 + math.copysign(math.pi / 2, turn))
                if self._inside(centre - radius_m) and self._inside(centre + radius_m):
                    return turn if at is point else 0.0
            at = at + self.leg_m * _unit(heading)
        return None

    def _radius_m(self) -> float:
        """Of the circle on which control points lie that always turn by turn_deg."""
        return self.leg_m / (2 * math.sin(math.radians(self.turn_deg) / 2))

    def _inside(self, points: Array) -> np.bool_:
        slack = 1e-9 * self.leg_m  # a circle that touches the box may be tested again from its next point
        return np.all((points >= self.low_m - slack) & (points <= self.high_m + slack))


def _unit(angle: float) -> Array:
    return np.array([math.cos(angle), math.sin(angle)])


def _slope(powers: Array, u: Array) -> Array:
    """d position / du (…, 2) of pieces (…, 4, 2) at u (…,)."""
    terms = np.stack([np.zeros_like(u), np.ones_like(u), 2 * u, 3 * u**2], axis=-1)
    return np.asarray(np.einsum("...p,...pa->...a", terms, powers))


def _length(powers: Array, u: Array) -> Array:
    """Length (n,) of pieces (n, 4, 2) from 0 to u (n,), by Gauss-Legendre quadrature."""
    at = u[:, None] * (_NODES + 1) / 2
    return np.asarray(u / 2 * np.sum(np.linalg.norm(_slope(powers[:, None], at), axis=-1) * _WEIGHTS, axis=-1))
