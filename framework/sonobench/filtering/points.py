"""Sigma points and the moments that a function's values at them give."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sonobench.filtering.gaussian import root, symmetric
from sonobench.protocols import BoundMeasurement
from sonobench.types import Array, Floats


def spread(m: Floats, P: Floats, radius: float) -> Array:
    """m ± radius · the columns of a root of P: (…, 2 d, d), the positive half first."""
    offsets = radius * np.swapaxes(root(P), -1, -2)
    centre = np.asarray(m)[..., None, :]
    d = offsets.shape[-1]
    x = np.empty((*offsets.shape[:-2], 2 * d, d))
    np.add(centre, offsets, out=x[..., :d, :])
    np.subtract(centre, offsets, out=x[..., d:, :])
    return x


#: most steps towards the mean of a curved space, and the length at which one is the last
_STEPS, _SHORT = 8, 1e-9


def image_moments(
    x: Floats, m: Floats, w_mean: Array, w_cov: Array, measurement: BoundMeasurement, q: int, pose: Array | None
) -> tuple[Array, Array, Array]:
    """Moments, as of `weighted_moments`, of points x (…, p, d) through a measurement of one mode."""
    z = measurement.h(x, q, pose)[..., 0, :]
    moved = getattr(measurement, "moved", None)
    return weighted_moments(
        x, z, m, w_mean, w_cov, lambda a, b: measurement.residual(a, b, q), None if moved is None else lambda a, step: moved(a, step, q)
    )


def weighted_moments(
    x: Floats,
    z: Floats,
    m: Floats,
    w_mean: Array,
    w_cov: Array,
    residual: Callable[[Floats, Floats], Floats],
    moved: Callable[[Floats, Floats], Floats] | None = None,
) -> tuple[Array, Array, Array]:
    """Mean, covariance and cross-covariance of points x (…, p, d) and their images z (…, p, dz).

    The mean is taken of the differences from the first image, so that a periodic measurement averages on the circle. Where the
    measurement space is curved, `moved` undoes `residual` (see `BoundMeasurement`), and the mean is where differences average to zero.

    Returns:
        ẑ (…, dz), (…, dz, dz), (…, d, dz).
    """
    first = z[..., :1, :]
    z_hat = first[..., 0, :]
    if moved is None:
        z_hat = z_hat + w_mean @ residual(z, first)
    else:
        for _ in range(_STEPS):
            step = w_mean @ residual(z, z_hat[..., None, :])
            z_hat = moved(z_hat, step)
            if np.max(np.abs(step), initial=0.0) < _SHORT:
                break
    off = residual(z, z_hat[..., None, :])
    weighted = off * w_cov[:, None]
    return (
        np.asarray(z_hat),
        symmetric(np.swapaxes(off, -1, -2) @ weighted),
        np.asarray(np.swapaxes(x - m[..., None, :], -1, -2) @ weighted),
    )
