"""Sigma points and the moments that a function's values at them give."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sonobench.filtering.gaussian import root, symmetric
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


def weighted_moments(
    x: Floats, z: Floats, m: Floats, w_mean: Array, w_cov: Array, residual: Callable[[Floats, Floats], Floats]
) -> tuple[Array, Array, Array]:
    """Mean, covariance and cross-covariance of points x (…, p, d) and their images z (…, p, dz).

    The mean is taken of the differences from the first image, so that a periodic measurement averages on the circle.

    Returns:
        ẑ (…, dz), (…, dz, dz), (…, d, dz).
    """
    first = z[..., :1, :]
    z_hat = first[..., 0, :] + w_mean @ residual(z, first)
    off = residual(z, z_hat[..., None, :])
    weighted = off * w_cov[:, None]
    return (
        np.asarray(z_hat),
        symmetric(np.swapaxes(off, -1, -2) @ weighted),
        np.asarray(np.swapaxes(x - m[..., None, :], -1, -2) @ weighted),
    )
