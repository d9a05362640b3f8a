"""Points, poses and delays."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sonobench.types import Array, Floats, Ints, Sensor, Setup


def place(pose: ArrayLike, points: ArrayLike) -> Array:
    """Points (…, 3) of an array's frame in the room, by a homogeneous pose (4, 4)."""
    pose = np.asarray(pose, float)
    return np.asarray(points, float) @ pose[:3, :3].T + pose[:3, 3]


def pair_delays(points: Floats, elements: Array, pairs: Ints, c_m_s: float) -> Floats:
    """tau = (|x − m_i| − |x − m_j|) / c, positive when i is farther.

    Args:
        points: (…, 3) m in the room.
        elements: (k, 3) m in the room.
        pairs: (P, 2) rows (i, j) of `elements`.

    Returns:
        (…, P) s.
    """
    square = (np.asarray(points)[..., None, :] - elements) ** 2
    distance = np.sqrt(square[..., 0] + square[..., 1] + square[..., 2])  # a third of the time of a sum over so short an axis
    return (distance[..., pairs[:, 0]] - distance[..., pairs[:, 1]]) / c_m_s


def max_delay(elements: Array, pairs: Ints, c_m_s: float) -> Array:
    """The largest |tau| of each pair (P,), its aperture over the speed of sound."""
    return np.linalg.norm(elements[pairs[:, 0]] - elements[pairs[:, 1]], axis=-1) / c_m_s


def sensor_delays(points: Floats, setup: Setup, sensor: int, pose: Array | None = None) -> Floats:
    """Delays (…, dz) that a "tdoa" sensor of the setup would measure of points (…, 3) or (…, 2).

    Points (…, 2) lie at the setup's nominal `height_m` (0 where it has none).
    """
    unit: Sensor = setup.sensors[sensor]
    elements = place(setup.pose(unit) if pose is None else pose, unit.elements)
    return pair_delays(lift(points, setup.nominal.get("height_m", 0.0)), elements, unit.pairs, setup.c_m_s)


def lift(points: Any, height_m: float) -> Floats:
    """Points (…, 2) or (…, 3) as (…, 3), planar ones at `height_m`."""
    points = np.asarray(points, float)
    if points.shape[-1] == 3:
        return points
    return np.concatenate([points, np.full((*points.shape[:-1], 1), height_m)], axis=-1)


def unit_vector(z: ArrayLike) -> Floats:
    """Unit vectors (…, 3) towards directions z (…, 2): azimuth, counter-clockwise from +x, and elevation from the xy plane, rad."""
    z = np.asarray(z, float)
    level = np.cos(z[..., 1])
    return np.stack([level * np.cos(z[..., 0]), level * np.sin(z[..., 0]), np.sin(z[..., 1])], axis=-1)


def angles(u: ArrayLike) -> Floats:
    """Azimuth in (−π, π] and elevation in [−π/2, π/2], rad (…, 2), of vectors u (…, 3) of any length; the azimuth is 0 straight up and down."""
    u = np.asarray(u, float) + 0.0  # −0 would send the azimuth of (−1, −0) to −π
    return np.stack([np.arctan2(u[..., 1], u[..., 0]), np.arctan2(u[..., 2], np.hypot(u[..., 0], u[..., 1]))], axis=-1)
