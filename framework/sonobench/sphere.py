"""Directions as points of a sphere: differences, means and covariances that mean the same at the pole as at the horizon.

A direction z is (azimuth, elevation) in rad. Azimuth is no measure of distance: near a pole a small step changes it by any
amount, so differences of angles, their means and their variances fail there. Here they are taken in the plane that touches the
sphere at one of two directions, with the axes east (growing azimuth) and north (growing elevation), both in rad of arc.
`across` and `stepped` are the same of unit vectors, for fits that never leave them.
Source: do Carmo 1992, "Riemannian geometry", chapter 3 (exponential map); Pennec 2006, "Intrinsic statistics on Riemannian
manifolds"; Mardia & Jupp 2000, "Directional statistics", section 9.
"""

from __future__ import annotations

import numpy as np

from sonobench.geometry import angles, unit_vector
from sonobench.types import Array, Floats

#: cosine below which an elevation counts as the pole when a variance of azimuth is turned into one of arc, or back
_POLE = 1e-9


def tangents(z: Floats) -> Array:
    """East and north at directions (…, 2) as the rows of (…, 2, 3); at a pole, where no azimuth is, those of the azimuth that z names."""
    z = np.asarray(z, float)
    ca, sa, ce, se = np.cos(z[..., 0]), np.sin(z[..., 0]), np.cos(z[..., 1]), np.sin(z[..., 1])
    east = np.stack([-sa, ca, np.zeros_like(ca)], axis=-1)
    north = np.stack([-se * ca, -se * sa, ce], axis=-1)
    return np.stack([east, north], axis=-2)


def apart(z: Floats, at: Floats) -> Array:
    """The step (…, 2), east and north in rad of arc, that leads from the direction `at` (…, 2) to z (…, 2) on their great circle.

    Its length is the angle between them, at most pi; between antipodes, which any step of pi joins, it points east.
    """
    z, at = np.asarray(z, float), np.asarray(at, float)
    turn = z[..., 0] - at[..., 0]
    ce, se, ce0, se0 = np.cos(z[..., 1]), np.sin(z[..., 1]), np.cos(at[..., 1]), np.sin(at[..., 1])
    half = np.sin(0.5 * turn)
    east = ce * np.sin(turn)
    north = np.sin(z[..., 1] - at[..., 1]) + 2.0 * se0 * ce * half**2  # se ce0 − ce se0 cos(turn), without cancellation
    along = se * se0 + ce * ce0 * np.cos(turn)
    away = np.hypot(east, north)
    angle = np.arctan2(away, along)
    scale = np.divide(angle, away, out=np.ones_like(angle), where=away > 0)
    step = np.stack([east * scale, north * scale], axis=-1)
    opposite = (away == 0) & (along < 0)
    step[opposite] = [np.pi, 0.0]
    return step


def moved(at: Floats, step: Floats) -> Array:
    """The direction (…, 2) that a step (…, 2), as of `apart`, leads to from `at` (…, 2)."""
    at, step = np.asarray(at, float), np.asarray(step, float)
    length = np.hypot(step[..., 0], step[..., 1])[..., None]
    T = tangents(at)
    ahead = T[..., 0, :] * step[..., :1] + T[..., 1, :] * step[..., 1:]
    return np.asarray(angles(unit_vector(at) * np.cos(length) + ahead * np.sinc(length / np.pi)))


def carried(R: Floats, z: Floats, at: Floats) -> Array:
    """Covariances (…, 2, 2) of (azimuth, elevation) at directions z (…, 2) as those of `apart(z, at)`.

    The variance of azimuth becomes one of arc east (cos² of the elevation), and the axes turn along the great circle to `at`.
    """
    return transported(in_arc(R, z), z, at)


def in_arc(R: Floats, z: Floats) -> Array:
    """Covariances (…, 2, 2) of (azimuth, elevation) at z (…, 2) as those of arcs east and north."""
    return np.asarray(R * _scales(z))


def in_angles(R: Floats, z: Floats) -> Array:
    """Covariances (…, 2, 2) of arcs east and north at z (…, 2) as those of (azimuth, elevation): the inverse of `in_arc`."""
    return np.asarray(R / _scales(z))


def _scales(z: Floats) -> Array:
    cosine = np.maximum(np.abs(np.cos(np.asarray(z, float)[..., 1])), _POLE)
    scale = np.stack([cosine, np.ones_like(cosine)], axis=-1)
    return np.asarray(scale[..., :, None] * scale[..., None, :])


def transported(R: Floats, z: Floats, at: Floats) -> Array:
    """Covariances (…, 2, 2) of arcs east and north at z (…, 2), in the axes at `at` (…, 2): turned along the great circle between."""
    there, back = apart(z, at), -apart(at, z)
    length = np.sum(there**2, axis=-1)
    safe = np.where(length > 0, length, 1.0)
    c = np.where(length > 0, np.sum(there * back, axis=-1) / safe, 1.0)
    s = np.where(length > 0, (there[..., 1] * back[..., 0] - there[..., 0] * back[..., 1]) / safe, 0.0)
    T = np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)
    return np.asarray(T @ R @ np.swapaxes(T, -1, -2))


def rotated(z: Floats, R: Floats | None, rotation: Array) -> tuple[Array, Array | None]:
    """Directions (…, 2), and covariances (…, 2, 2) of their angles, in axes turned by `rotation` (3, 3): u becomes rotation · u."""
    z = np.asarray(z, float)
    there = np.asarray(angles(unit_vector(z) @ rotation.T), float)
    if R is None:
        return there, None
    T = tangents(there) @ rotation @ np.swapaxes(tangents(z), -1, -2)
    return there, in_angles(T @ in_arc(R, z) @ np.swapaxes(T, -1, -2), there)


def across(u: Floats) -> Array:
    """Orthonormal columns (…, 3, 2) across unit vectors (…, 3): `tangents` of vectors; at a pole those of azimuth 0."""
    u = np.asarray(u)
    x, y, z = u[..., 0], u[..., 1], u[..., 2]
    level = np.sqrt(x * x + y * y)
    pole = level < 1e-12
    safe = np.where(pole, 1.0, level)
    cos, sin = np.where(pole, 1.0, x / safe), y / safe
    out = np.zeros((*u.shape, 2))
    out[..., 0, 0], out[..., 1, 0] = -sin, cos
    out[..., 0, 1], out[..., 1, 1], out[..., 2, 1] = -z * cos, -z * sin, level
    return out


def stepped(u: Floats, step: Floats) -> Array:
    """Unit vectors (…, 3) after steps (…, 2) along `across`, of at most a quarter radian."""
    size = np.linalg.norm(step, axis=-1, keepdims=True)
    step = step * np.minimum(1.0, 0.25 / np.maximum(size, 1e-300))
    there = u + (across(u) @ step[..., None])[..., 0]
    return np.asarray(there / np.linalg.norm(there, axis=-1, keepdims=True))


def spread_directions(n: int) -> Array:
    """n unit vectors (n, 3), evenly over the sphere (a Fibonacci lattice)."""
    k = np.arange(n)
    z = 1 - (2 * k + 1) / n
    turn = np.pi * (1 + 5**0.5) * k
    level = np.sqrt(1 - z * z)
    return np.stack([level * np.cos(turn), level * np.sin(turn), z], axis=1)


__all__ = [
    "across",
    "apart",
    "carried",
    "in_angles",
    "in_arc",
    "moved",
    "rotated",
    "spread_directions",
    "stepped",
    "tangents",
    "transported",
]
