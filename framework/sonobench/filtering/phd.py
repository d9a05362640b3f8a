"""The PHD corrector, for components and for particles.

Source: Mahler 2003, "Multitarget Bayes filtering via first-order multitarget moments", eq. 87; Vo & Ma 2006, eq. 20 to 22.
A row with missing components is used through its valid ones: likelihood and clutter intensity are both their marginals,
which takes it that which components are missing says nothing of where the row comes from.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sonobench.filtering.evidence import Rows, noise_of, rows_of
from sonobench.filtering.gaussian import SINGULAR
from sonobench.filtering.mixture import kernels, take, union
from sonobench.filtering.particles import particle_kernels
from sonobench.protocols import BoundMeasurement, Mixture
from sonobench.types import Array, Bools, Floats, Ints, Scan


class Moments(NamedTuple):
    """A Gaussian through h: z_hat (J, dz), S (J, dz, dz) without R, cross (J, d, dz)."""

    z_hat: Array
    S: Array
    cross: Array


def patterns(rows: Rows) -> Iterator[tuple[Ints, Bools]]:
    """(row numbers, their valid components) for each pattern of missing components."""
    if rows.valid.all():
        if len(rows.z):
            yield np.arange(len(rows.z), dtype=np.int64), np.ones(rows.z.shape[1], bool)
        return
    kinds, of = np.unique(rows.valid, axis=0, return_inverse=True)
    for k, valid in enumerate(kinds):
        yield np.flatnonzero(of.reshape(-1) == k).astype(np.int64), np.asarray(valid)


def log_intensity(measurement: BoundMeasurement, z: Floats, q: int, valid: Bools) -> Array:
    """log clutter intensity (m,) of rows (m, dz) of which only the components `valid` (dz,) are there."""
    return np.asarray(measurement.log_clutter(z, q) if valid.all() else measurement.log_clutter(z, q, valid))


def correct(prior: Mixture, moments: Moments, scan: Scan, measurement: BoundMeasurement, q: int, above: float = -1.0) -> Mixture:
    """One sensor's PHD update of a Gaussian mixture: what was missed, then what each row says (Vo & Ma 2006, eq. 20).

    p_D is taken at each component's mean.

    Args:
        prior: J components.
        moments: theirs, through h.
        scan: its rows of sensor q are used.
        measurement: noise, p_D, clutter and residual of q.
        q: the sensor.
        above: components of a weight at or below are left out. All count in the weights of the others, so that this is the
            same as to prune afterwards, but most means and covariances need not be worked out.

    Returns:
        J (1 + m) components less those left out: first the missed ones, then for each row the detected ones.
    """
    rows = rows_of(scan, q, moments.z_hat.shape[-1])
    p_d = measurement.p_d(prior.m, q, scan)[..., 0]
    missed = prior._replace(w=prior.w * (1.0 - p_d))
    parts = [take(missed, missed.w > above)]
    with np.errstate(divide="ignore"):
        log_prior = np.log(prior.w) + np.log(p_d)
    for which, valid in patterns(rows):
        z, noise = rows.z[which], noise_of(measurement, scan, q, rows, which, moments.z_hat)
        residual = measurement.residual(z, moments.z_hat[:, None, :], q)  # (J, m, dz)
        log_kappa = log_intensity(measurement, z, q, valid)
        S, cross = moments.S, moments.cross
        if not valid.all():
            residual, cross = residual[..., valid], cross[..., valid]
            S, noise = S[:, valid][:, :, valid], noise[..., valid, :][..., valid]
        parts.append(_detected(prior, log_prior, (residual, S[:, None] + noise, cross), log_kappa, above))
    return union(*parts)


def _detected(prior: Mixture, log_prior: Array, seen: tuple[Floats, Array, Array], log_kappa: Array, above: float) -> Mixture:
    """The components of eq. 21, row after row: `seen` holds residuals (J, m, dz), S (J, m or 1, dz, dz) with R, cross (J, d, dz)."""
    residual, S, cross = (np.ascontiguousarray(a, float) for a in seen)
    w = log_densities(residual, S)
    w += log_prior[:, None]
    kernels().share(w, np.ascontiguousarray(log_kappa, float))
    w, m, P, of = kernels().conditioned(w, np.ascontiguousarray(prior.m), np.ascontiguousarray(prior.P), residual, S, cross, above)
    return Mixture(w, m, P, prior.mode[of])


def reweigh(log_w: Array, x: Array, z_hat: Floats, scan: Scan, measurement: BoundMeasurement, q: int) -> tuple[Array, Array]:
    """One sensor's PHD update of particles x (N, d) with images z_hat (N, dz) (Vo, Singh & Doucet 2005, eq. 20).

    Returns:
        New log weights (N,) and the share of each row in each particle's weight (N, m), 0 below e^−60 of the row's largest.
    """
    rows = rows_of(scan, q, z_hat.shape[-1])
    p_d = measurement.p_d(x, q, scan)[..., 0]
    shape = len(rows.z), len(x)
    logs: Array = np.full(shape, -np.inf)
    shares: Array = np.zeros(shape)
    with np.errstate(divide="ignore"):
        log_joint, log_after = log_w + np.log(p_d), log_w + np.log1p(-p_d)
    by_component = np.ascontiguousarray(z_hat.T).T  # so that loops run along the particles
    for which, valid in patterns(rows):
        noise = noise_of(measurement, scan, q, rows, which, z_hat)
        residual = measurement.residual(rows.z[which], by_component[:, None, :], q)  # (N, m, dz)
        if not valid.all():
            noise, residual = noise[..., valid, :][..., valid], residual[..., valid]
        log_kappa = log_intensity(measurement, rows.z[which], q, valid)
        log = _likelihoods(residual, noise.reshape((1,) * (4 - noise.ndim) + noise.shape))
        share = np.empty(log.shape)
        particle_kernels().log_share(log, log_joint, np.ascontiguousarray(log_kappa, float), share)
        if len(which) == len(rows.z):
            logs, shares = log, share
        else:
            logs[which], shares[which] = log, share
    particle_kernels().add_logs(log_after, logs, shares.sum(axis=0))
    return log_after, shares.T


def _likelihoods(residual: Floats, S: Floats) -> Array:
    """`log_densities` of residuals (N, m, dz), the particles last: (m, N)."""
    if len(S) > 1:  # a noise of each particle
        return np.ascontiguousarray(log_densities(residual, S).T)
    log = np.empty(residual.shape[1::-1])
    if not particle_kernels().along(np.ascontiguousarray(residual.transpose(1, 2, 0), float), np.ascontiguousarray(S, float), log):
        raise ValueError(SINGULAR)
    return log


def log_densities(residual: Floats, S: Floats) -> Array:
    """log N (J, m) of residuals (J, m, dz) with covariances S (J or 1, m or 1, dz, dz).

    Raises:
        ValueError: S is singular.
    """
    log = np.empty(residual.shape[:2])
    if not kernels().log_densities(np.ascontiguousarray(residual, float), np.ascontiguousarray(S, float), log):
        raise ValueError(SINGULAR)
    return log
