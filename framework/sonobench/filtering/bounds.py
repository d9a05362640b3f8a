"""Bounds on the error of a direction: of one frame (Cramér-Rao), and of a track (posterior Cramér-Rao).

A direction's error is the step on the sphere from truth to estimate, east and north in rad of arc (`sonobench.sphere`), so
information is (2, 2) and the bound of the mean squared angular error (MSAE) is the trace of its inverse.
Source: Nehorai & Paldi 1994, "Acoustic vector-sensor array processing", section III; Kay 1993, "Fundamentals of statistical signal
processing: estimation theory", section 3.9 (Gaussian likelihoods); Stoica & Nehorai 1989 (signals as unknown constants); Tichavský,
Muravchik & Nehorai 1998, "Posterior Cramér-Rao bounds for discrete-time nonlinear filtering", eq. 21 and 34; Hernandez, Ristic,
Farina, Sathyan & Kirubarajan 2005, "Performance measure for Markovian switching systems using best-fitting Gaussian distributions".
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from sonobench.filtering.gaussian import symmetric
from sonobench.geometry import unit_vector
from sonobench.sphere import tangents
from sonobench.types import Array, Floats

Signal = Literal["gaussian", "deterministic"]
Unknown = Literal["known", "diagonal"]


def direction_information(
    z: Floats,
    source_variance: Floats | float,
    noise: Floats,
    snapshots: float,
    signal: Signal = "gaussian",
    unknown: Unknown = "known",
) -> Array:
    """Fisher information of the direction of one source in independent real snapshots (1; u) s + e of a vector sensor.

    The power of a Gaussian source, or each sample of a deterministic one, is unknown too and has been eliminated.

    Args:
        z: (…, 2) azimuth and elevation.
        source_variance: (…) of s, the mean of its squares where it is deterministic.
        noise: (4, 4) covariance of e; pressure and the scaled velocities.
        snapshots: their number.
        signal: what s is.
        unknown: whether the noise is "known", or "diagonal" with four unknown variances (for a Gaussian source; elsewhere it does not matter).

    Returns:
        (…, 2, 2) for arcs east and north, rad⁻².
    """
    z = np.asarray(z, float)
    power = np.asarray(source_variance, float)[..., None, None]
    a = np.concatenate([np.ones((*z.shape[:-1], 1)), unit_vector(z)], axis=-1)
    slope = np.concatenate([np.zeros((*z.shape[:-1], 2, 1)), tangents(z)], axis=-1)  # (…, 2, 4)
    if signal == "deterministic":
        white = np.linalg.inv(np.linalg.cholesky(noise))
        b, db = a @ white.T, slope @ white.T
        along = (db @ b[..., None])[..., 0]
        across = db @ np.swapaxes(db, -1, -2) - along[..., :, None] * along[..., None, :] / np.sum(b**2, axis=-1)[..., None, None]
        return np.asarray(snapshots * power * across)
    outer = a[..., :, None] * a[..., None, :]
    inverse = np.linalg.inv(power * outer + noise)
    mixed = slope[..., :, :, None] * a[..., None, None, :]
    changes = [power[..., None] * (mixed + np.swapaxes(mixed, -1, -2)), outer[..., None, :, :]]
    if unknown == "diagonal":
        changes.append(np.broadcast_to(np.eye(4)[:, :, None] * np.eye(4)[:, None, :], (*z.shape[:-1], 4, 4, 4)))
    D = inverse[..., None, :, :] @ np.concatenate(changes, axis=-3)
    full = 0.5 * snapshots * np.einsum("...iab,...jba->...ij", D, D)
    return _eliminated(full, 2)


def _eliminated(information: Array, kept: int) -> Array:
    """Information (…, kept, kept) of the first parameters when the others are unknown: a Schur complement."""
    A, B, C = information[..., :kept, :kept], information[..., :kept, kept:], information[..., kept:, kept:]
    return symmetric(A - B @ np.linalg.solve(C, np.swapaxes(B, -1, -2)))


def least_msae(source_variance: float, pressure_variance: float, velocity_variance: float, snapshots: float) -> float:
    """The bound of the MSAE (rad²) for white noise that is equal in the three velocities, in closed form.

    2 σ_v² (σ_s² + σ_p² σ_v² / (σ_p² + σ_v²)) / (N σ_s⁴), the least over α of 2 σ_v² (σ_s² + α² σ_p² + (1 − α)² σ_v²) / (N σ_s⁴).
    """
    least = pressure_variance * velocity_variance / (pressure_variance + velocity_variance)
    return float(2 * velocity_variance * (source_variance + least) / (snapshots * source_variance**2))


def posterior_covariances(P: Array, F: Floats, Q: Floats, H: Floats, information: Floats) -> Array:
    """Covariances below which no unbiased tracker's stay: J_k = (F J_{k−1}⁻¹ Fᵀ + Q)⁻¹ + Hᵀ I H, along a path.

    Exact for linear Gaussian motion; along one path it takes H and I there in place of their expectations over paths. Q may be singular.

    Args:
        P: (d, d) covariance at the start.
        F, Q: (k, d, d), of a step each.
        H: (k, m, d) slope of what is measured.
        information: (k, m, m) of what is measured; zeros where nothing is.

    Returns:
        (k, d, d).
    """
    found = np.empty(np.shape(F))
    for k in range(len(found)):
        P = F[k] @ P @ F[k].T + Q[k]
        root = H[k].T @ _root(information[k])
        cross = P @ root
        P = symmetric(P - cross @ np.linalg.solve(np.eye(root.shape[1]) + root.T @ cross, cross.T))
        found[k] = P
    return found


def _root(information: Floats) -> Array:
    values, vectors = np.linalg.eigh(information)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def best_fitting(F: Floats, Q: Floats, probability: Floats, m: Floats, P: Floats) -> tuple[Array, Array]:
    """The one motion x' = F̄ x + w, w ~ N(·, Q̄), whose first two moments are those of a switch between motions (Hernandez et al. 2005).

    Args:
        F, Q: (j, d, d) of each mode.
        probability: (j,) of each mode in this step, summing to one.
        m, P: (d,), (d, d) mean and covariance of the state before the step.

    Returns:
        F̄, Q̄ (d, d); what modes disagree about, weighed by how probable they are, counts as process noise.
    """
    p = np.asarray(probability, float)
    mean = np.einsum("j,jab->ab", p, F)
    second = P + np.outer(m, m)
    apart = F - mean
    return mean, symmetric(np.einsum("j,jab->ab", p, Q + apart @ second @ np.swapaxes(apart, -1, -2)))


__all__ = ["Signal", "Unknown", "best_fitting", "direction_information", "least_msae", "posterior_covariances"]
