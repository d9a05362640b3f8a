"""Gaussians in batches: roots, densities, conditioning."""

from __future__ import annotations

import math

import numpy as np

from sonobench.types import Array, Floats

#: most negative eigenvalue, in units of the correlation matrix, that still counts as rounding
_ROUNDING = 1e-8

#: what is said of an innovation covariance without a Cholesky factor
SINGULAR = "an innovation covariance is singular; give the measurement a noise above zero"


def symmetric(P: Floats) -> Array:
    """The symmetric part of (…, d, d)."""
    return np.asarray(0.5 * (P + np.swapaxes(P, -1, -2)), float)


def root(P: Floats) -> Array:
    """A with A Aᵀ = P for covariances (…, d, d): the Cholesky factor where there is one, else a scaled eigen root.

    A semi-definite matrix (a degenerate process noise, a coordinate without spread) has no Cholesky factor; its root is
    then taken of the correlation matrix, so that metres, m/s and seconds are rounded alike.

    Raises:
        ValueError: a matrix is not positive semi-definite.
    """
    P = np.asarray(P, float)
    try:
        return np.asarray(np.linalg.cholesky(P))
    except np.linalg.LinAlgError:
        flat = P.reshape(-1, *P.shape[-2:])
        return np.stack([_root_of_one(p) for p in flat]).reshape(P.shape)


def _root_of_one(P: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(P))
    except np.linalg.LinAlgError:
        scale = np.sqrt(np.maximum(np.diag(P), 0.0))
        safe = np.where(scale > 0, scale, 1.0)
        values, vectors = np.linalg.eigh(symmetric(P / safe[:, None] / safe))
        if not np.isfinite(values).all() or values.min() < -_ROUNDING * max(1.0, values.max()):
            raise ValueError(f"a covariance is not positive semi-definite (smallest correlation eigenvalue {values.min():.3g})") from None
        return np.asarray(safe[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


def definite(P: Floats, relative: float = 1e-12) -> Array:
    """P (…, d, d) with `relative` of its own diagonal added, so that it can be inverted; never an absolute jitter."""
    more = np.array(P, float)
    diagonal = np.einsum("...ii->...i", more)  # a view of `more`
    floor = np.max(diagonal, axis=-1, keepdims=True) * relative
    diagonal += np.maximum(diagonal * relative, floor * relative)
    return more


def log_gaussian(residual: Floats, S: Floats) -> Array:
    """log N(residual; 0, S) of (…, d) and (…, d, d), broadcast against each other.

    Raises:
        ValueError: S is singular (a measurement noise of zero).
    """
    try:
        factor = np.linalg.cholesky(S)
    except np.linalg.LinAlgError:
        raise ValueError(SINGULAR) from None
    white = (np.linalg.inv(factor) @ np.asarray(residual)[..., None])[..., 0] if factor.ndim > 2 else residual @ np.linalg.inv(factor).T
    log_det = 2.0 * np.sum(np.log(np.diagonal(factor, axis1=-2, axis2=-1)), axis=-1)
    return np.asarray(-0.5 * (np.sum(white**2, axis=-1) + log_det + residual.shape[-1] * math.log(2 * math.pi)))


def gain(cross: Floats, S: Floats) -> Array:
    """K = cross S⁻¹ (…, d, dz)."""
    return np.asarray(np.swapaxes(np.linalg.solve(S, np.swapaxes(cross, -1, -2)), -1, -2))


def log_degenerate(residual: Floats, Q: Array, magnitude: Floats) -> Array:
    """log N(residual; 0, Q) on the support of a semi-definite Q, −inf off it.

    The density is with respect to Lebesgue measure on the support, the column space of Q (a point mass, 0, where Q = 0).

    Args:
        residual: (n, d).
        Q: (d, d).
        magnitude: (n,) size of the numbers whose difference the residual is; off the support counts what exceeds 1e-9 of
            it and 1e-6 of Q's largest deviation (a Cholesky root of a singular Q leaves its column space by the root of a
            rounding, and what it draws must lie on the support).
    """
    values, vectors = np.linalg.eigh(symmetric(Q))
    within = values > 1e-13 * max(values.max(), 0.0)
    turned = residual @ vectors
    inside, outside = turned[:, within], turned[:, ~within]
    variance = values[within]
    log = -0.5 * (np.sum(inside**2 / variance, axis=-1) + np.sum(np.log(2 * math.pi * variance)))
    slack = 1e-9 * magnitude[:, None] + 1e-6 * math.sqrt(max(values.max(), 0.0))
    return np.asarray(np.where(np.all(np.abs(outside) <= slack, axis=-1), log, -np.inf))
