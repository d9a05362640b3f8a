"""The tracking scene of Hu, Li & Jin 2014, section 4.2, at measurement level: directions with the errors of the static bound."""

from __future__ import annotations

import numpy as np

from sonobench.geometry import angles, unit_vector
from sonobench.sphere import in_angles, moved
from sonobench.types import Array, Detections, Scan, Sensor, Setup, Space, Truth

START_M = 1000.0 * unit_vector(np.radians([30.0, 30.0]))
VELOCITY_M_S = np.array([20.0, -10.0, -20.0])
STEPS = 120
#: σ_s², σ_p², σ_v² → elevation and azimuth RMSE (rad) of Table 2 (WPF-MP) and Table 3 (WPF-MPT)
TABLES = {
    (np.sqrt(10.0), 1.5, 0.5): (0.0046, 0.0051, 0.0029, 0.0032),
    (np.sqrt(10.0), 1.0, 1.0): (0.0067, 0.0074, 0.0040, 0.0043),
    (10.0, 1.5, 0.5): (0.0025, 0.0027, 0.0017, 0.0018),
    (1.0, 1.5, 0.5): (0.0092, 0.0100, 0.0052, 0.0057),
}


def setup(pose: Array | None = None) -> Setup:
    """One vector sensor at the origin; the start is given."""
    sensor = Sensor("avs-0", "avs", "direction", np.zeros((1, 3)), Space.of("azimuth_rad", "elevation_rad"))
    start = np.concatenate([[0.0], START_M, VELOCITY_M_S])[None]
    return Setup((sensor,), ("avs",), np.eye(4)[None] if pose is None else pose[None], period_s=1.0, given={"starts": start})


def truth(steps: int = STEPS, parameters: dict[str, float] | None = None) -> Truth:
    """Constant velocity."""
    time_s = np.arange(1.0, steps + 1)
    position = (START_M + time_s[:, None] * VELOCITY_M_S)[:, None]
    there = np.ones((steps, 1), bool)
    velocity = np.broadcast_to(VELOCITY_M_S, position.shape)
    return Truth(time_s, np.array([0]), position, there, there, velocity, period_s=1.0, parameters=parameters or {})


def scans(rng: np.random.Generator, points: Array, std_rad: float) -> list[Scan]:
    """A row a scan, seconds apart, of points (k, 3) seen from the origin, with arcs of deviation `std_rad` and the R that says so."""
    z = np.asarray(angles(points))
    seen = moved(z, std_rad * rng.standard_normal(z.shape))
    R = in_angles(np.broadcast_to(std_rad**2 * np.eye(2), (len(z), 2, 2)), seen)
    return [Scan(k + 1.0, np.ones(1, bool), (Detections(seen[k : k + 1], np.zeros(1, int), R[k : k + 1]),)) for k in range(len(z))]


def static_std(source: float, pressure: float, velocity: float, snapshots: int = 8000) -> float:
    """Deviation along one axis of the sphere at the bound (Nehorai & Paldi 1994): half of its MSAE, squared root."""
    weighted = pressure * velocity / (pressure + velocity)
    return float(np.sqrt(velocity * (source + weighted) / (snapshots * source**2)))
