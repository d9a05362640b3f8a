"""The peaks of a positive field over directions: where they are, how high, how wide.

Local maxima on an even grid of the sphere are refined by Newton steps on the logarithm in the plane that touches the sphere there; the
curvature at the top is that of a Gaussian of the same peak (Laplace's approximation).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from sonobench.filtering.gaussian import symmetric
from sonobench.geometry import angles, unit_vector
from sonobench.sphere import moved
from sonobench.types import Array, Field, Ints

_POINTS = 4000
_SAME = 1e-3  # rad: tops that lie closer are one
_STEP = 0.008  # rad, of differences
_ROUNDS = 4
_FURTHEST = 0.04  # rad, of one Newton step: a grid cell
_WIDTHS = (0.006, 0.3)  # rad, between which a peak's deviations are kept
_STENCIL = _STEP * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [-1, -1], [1, -1], [-1, 1]], float)


class FieldPeaks(NamedTuple):
    """z (k, 2) azimuth and elevation, the highest first; height (k,) of the field; R (k, 2, 2) rad² along east and north."""

    z: Array
    height: Array
    R: Array


def field_peaks(field: Field, sensor: int, threshold: float, most: int) -> FieldPeaks:
    """Peaks of one sensor's field that reach `threshold` times the highest, at most `most`; none of a field that is nowhere positive."""
    of: Ints = np.array([sensor], np.int64)
    values = np.asarray(field.at(_grid()[0][:, None, :], of))[:, 0]
    top = float(values.max())
    if not top > 0:
        return FieldPeaks(np.zeros((0, 2)), np.zeros(0), np.zeros((0, 2, 2)))
    low = np.flatnonzero((values >= 0.5 * threshold * top) & (values[:, None] >= values[_grid()[1]]).all(axis=1))
    z = _grid()[0][low[np.argsort(-values[low], kind="stable")][: 2 * most]]
    for _ in range(_ROUNDS):
        gradient, H, _ = _log_shape(field, of, z)
        step = np.linalg.solve(_concave(H), -gradient[..., None])[..., 0]
        size = np.linalg.norm(step, axis=1, keepdims=True)
        z = moved(z, step * np.minimum(1.0, _FURTHEST / np.maximum(size, 1e-300)))
    _, H, height = _log_shape(field, of, z)
    keep = np.argsort(-height, kind="stable")
    keep = keep[height[keep] >= threshold * height.max()]
    near = np.sum((unit_vector(z[keep])[:, None] - unit_vector(z[keep])) ** 2, axis=-1) < _SAME**2
    keep = keep[~np.triu(near, 1).any(axis=0)][:most]  # several starts may climb one ridge
    return FieldPeaks(z[keep], height[keep], symmetric(np.linalg.inv(-_concave(H[keep]))))


@cache
def _grid() -> tuple[Array, Ints]:
    """Directions (n, 2) some 3° apart on a Fibonacci spiral, and the eight nearest others (n, 8) of each."""
    from scipy.spatial import cKDTree

    k = np.arange(_POINTS)
    z = np.stack([np.pi * (1 + 5**0.5) * k, np.arcsin(1 - (2 * k + 1) / _POINTS)], axis=1)
    u = unit_vector(z)
    near = np.asarray(cKDTree(u).query(u, 9)[1][:, 1:], np.int64)
    at = np.array(angles(u), np.float64)
    at.flags.writeable = near.flags.writeable = False
    return at, near


def _log_shape(field: Field, of: Ints, z: Array) -> tuple[Array, Array, Array]:
    """Gradient (k, 2) and Hessian (k, 2, 2) of the field's logarithm, by differences east and north, and the field (k,)."""
    around = moved(z[:, None, :], np.broadcast_to(_STENCIL, (len(z), *_STENCIL.shape)))
    value = np.asarray(field.at(around[..., None, :], of), np.float64)[..., 0]
    f = np.log(np.maximum(value, np.finfo(float).tiny))
    gradient = np.stack([f[:, 1] - f[:, 2], f[:, 3] - f[:, 4]], axis=1) / (2 * _STEP)
    h = _STEP**2
    xx, yy = (f[:, 1] - 2 * f[:, 0] + f[:, 2]) / h, (f[:, 3] - 2 * f[:, 0] + f[:, 4]) / h
    xy = (f[:, 5] + f[:, 6] - f[:, 7] - f[:, 8]) / (4 * h)
    return gradient, np.stack([np.stack([xx, xy], axis=1), np.stack([xy, yy], axis=1)], axis=1), value[:, 0]


def _concave(H: Array) -> Array:
    """Hessians with their curvatures kept to those of peaks that are neither needles nor plains."""
    values, vectors = np.linalg.eigh(H)
    values = np.clip(values, -1 / _WIDTHS[0] ** 2, -1 / _WIDTHS[1] ** 2)
    return np.asarray((vectors * values[:, None, :]) @ np.swapaxes(vectors, 1, 2))
