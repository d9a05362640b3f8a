"""The PHD corrector, for components and for particles.

Source: Mahler 2003, "Multitarget Bayes filtering via first-order multitarget moments", eq. 87; Vo & Ma 2006, eq. 20 to 22.
A row with missing components is used through its valid ones: likelihood and clutter intensity are both their marginals,
which takes it that which components are missing says nothing of where the row comes from.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from sonobench.filtering.evidence import Rows, rows_of
from sonobench.filtering.gaussian import gain, log_gaussian, symmetric
from sonobench.filtering.mixture import union
from sonobench.protocols import BoundMeasurement, Mixture
from sonobench.types import Array, Bools, Floats, Ints, Scan


class Moments(NamedTuple):
    """A Gaussian through h: z_hat (J, dz), S (J, dz, dz) without R, cross (J, d, dz)."""

    z_hat: Array
    S: Array
    cross: Array


def log_shares(log_w: Array, log_g: Array, log_p_d: Array, log_clutter: Array) -> Array:
    """log of each detected weight (J, m): p_D w g / (kappa + Σ p_D w g), from logs of w (J,), g (J, m), p_D (J,), kappa (m,)."""
    joint = (log_w + log_p_d)[:, None] + log_g
    evidence = np.logaddexp(np.logaddexp.reduce(joint, axis=0), log_clutter) if len(joint) else log_clutter
    return np.asarray(joint - np.where(np.isneginf(evidence), 0.0, evidence))


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


def correct(prior: Mixture, moments: Moments, scan: Scan, measurement: BoundMeasurement, q: int) -> Mixture:
    """One sensor's PHD update of a Gaussian mixture: what was missed, then what each row says (Vo & Ma 2006, eq. 20).

    p_D is taken at each component's mean.

    Args:
        prior: J components.
        moments: theirs, through h.
        scan: its rows of sensor q are used.
        measurement: noise, p_D, clutter and residual of q.

    Returns:
        J (1 + m) components: first the J missed ones, then for each row J detected ones.
    """
    rows = rows_of(scan, q, moments.z_hat.shape[-1])
    p_d = measurement.p_d(prior.m, q, scan)[..., 0]
    parts = [prior._replace(w=prior.w * (1.0 - p_d))]
    with np.errstate(divide="ignore"):
        log_w, log_p_d = np.log(prior.w), np.log(p_d)
    for which, valid in patterns(rows):
        noise = (measurement.R(q, scan) if rows.R is None else rows.R[which])[..., valid, :][..., valid]
        residual = measurement.residual(rows.z[which], moments.z_hat[:, None, :], q)[..., valid]  # (J, m, dz)
        S = moments.S[:, valid][:, :, valid][:, None] + noise  # (J, m or 1, dz, dz)
        cross = moments.cross[:, None, :, valid]
        log_w_z = log_shares(log_w, log_gaussian(residual, S), log_p_d, log_intensity(measurement, rows.z[which], q, valid))
        parts.append(_detected(prior, np.exp(log_w_z), residual, S, cross))
    return union(*parts)


def _detected(prior: Mixture, w: Array, residual: Floats, S: Array, cross: Array) -> Mixture:
    """The components of eq. 21: weights (J, m), residuals (J, m, dz), S and cross with row axis m or 1; row-major over m."""
    J, m = w.shape
    K = gain(cross, S)
    mean = prior.m[:, None] + (K @ residual[..., None])[..., 0]
    P = symmetric(prior.P[:, None] - K @ np.swapaxes(cross, -1, -2))
    P = np.broadcast_to(P, (J, m, *P.shape[-2:]))
    flat = [np.swapaxes(a, 0, 1).reshape(J * m, *a.shape[2:]) for a in (w, mean, P)]
    return Mixture(flat[0], flat[1], flat[2], np.tile(prior.mode, m))


def reweigh(log_w: Array, x: Array, z_hat: Floats, scan: Scan, measurement: BoundMeasurement, q: int) -> tuple[Array, Array]:
    """One sensor's PHD update of particles x (N, d) with images z_hat (N, dz) (Vo, Singh & Doucet 2005, eq. 20).

    Returns:
        New log weights (N,) and the log share of each row in each particle's weight (N, m).
    """
    rows = rows_of(scan, q, z_hat.shape[-1])
    p_d = measurement.p_d(x, q, scan)[..., 0]
    shares = np.full((len(x), len(rows.z)), -np.inf)
    with np.errstate(divide="ignore"):
        log_p_d, log_missed = np.log(p_d), log_w + np.log1p(-p_d)
    for which, valid in patterns(rows):
        noise = (measurement.R(q, scan) if rows.R is None else rows.R[which])[..., valid, :][..., valid]
        residual = measurement.residual(rows.z[which], z_hat[:, None, :], q)[..., valid]  # (N, m, dz)
        log_kappa = log_intensity(measurement, rows.z[which], q, valid)
        shares[:, which] = log_shares(log_w, log_gaussian(residual, noise), log_p_d, log_kappa)
    return np.logaddexp.reduce(np.column_stack([log_missed, shares]), axis=1), shares
