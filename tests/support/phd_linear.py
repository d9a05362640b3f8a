"""A linear position sensor, so that filters can be held against closed forms; and read-only arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.protocols import Mixture
from sonobench.types import Detections, Scan, Sensor, Setup, Space


@dataclass(frozen=True)
class Position:
    """z = (x, y) + noise of covariance R, uniform clutter of `clutter` rows over `area`."""

    std: float = 0.1
    probability: float = 0.9
    clutter: float = 0.0
    area: float = 100.0
    modes: int = 1

    def bind(self, space, setup):
        return BoundPosition(self, tuple(space.index("x_m", "y_m")), len(space), tuple(range(len(setup.sensors))))


@dataclass(frozen=True)
class BoundPosition:
    of: Position
    columns: tuple[int, ...]
    d: int
    sensors: tuple[int, ...]

    @property
    def n_modes(self):
        return self.of.modes

    def H(self):
        H = np.zeros((2, self.d))
        H[[0, 1], list(self.columns)] = 1
        return H

    def h(self, x, q, pose=None):
        return (x @ self.H().T)[..., None, :]

    def jacobian(self, x, q, pose=None):
        return np.broadcast_to(self.H(), (*np.shape(x)[:-1], 1, 2, self.d))

    def residual(self, z, z_hat, q):
        return z - z_hat

    def R(self, q, scan=None):
        return np.eye(2) * self.of.std**2

    def p_d(self, x, q, scan=None):
        return np.full((*np.shape(x)[:-1], 1), self.of.probability)

    def log_clutter(self, z, q, valid=None):
        side = np.sqrt(self.of.area)
        with np.errstate(divide="ignore"):
            return np.full(np.shape(z)[:-1], np.log(self.of.clutter) - (2 if valid is None else np.sum(valid)) * np.log(side))


def setup(sensors: int = 1, period_s: float | None = 1.0, **more) -> Setup:
    """`sensors` position sensors over a box of 10 m."""
    space = Space.of("x_m", "y_m")
    units = tuple(Sensor(f"s{i}", "a", "position", np.zeros((0, 3)), space) for i in range(sensors))
    return Setup(units, ("a",), np.eye(4)[None], period_s=period_s, box_m=[[0, 0, 0], [10, 10, 3]], **more)


def scan(time_s: float, z, searched=(True,), sensor=0, **more) -> Scan:
    """Rows z of one sensor."""
    z = np.asarray(z, float).reshape(-1, 2)
    return Scan(time_s, list(searched), (Detections(z, np.full(len(z), sensor), **more),))


def mixture(rng: np.random.Generator, n: int, d: int = 4, modes: int = 1) -> Mixture:
    """Random components, read-only."""
    A = rng.standard_normal((n, d, d)) * 0.5
    P = A @ np.swapaxes(A, 1, 2) + 0.1 * np.eye(d)
    return frozen(Mixture(rng.random(n) + 0.01, rng.standard_normal((n, d)) * 2, P, rng.integers(0, modes, n)))


def frozen(value: Mixture) -> Mixture:
    """The same arrays, read-only."""
    for array in value:
        array.flags.writeable = False
    return value
