"""Covariances of a vector sensor, the noise that they show, directions that maximise a quadratic on the unit sphere, and how exact they are.

A frame's covariance C (4, 4) over (p, vx, vy, vz), velocities scaled so that a plane wave s from u reads (s, u s), is C = σ_s² a aᵀ + Q with
a = [1; u] and Q the noise. Beamformers of one sensor maximise uᵀAu + 2 bᵀu over |u| = 1 with A and b from C; to first order their errors are
linear in those of C, δu = M : δC, so that their covariance follows from that of a sample covariance (`spread`).
Source: Levin, Gannot & Habets 2011 (maximum power); Hu, Li & Jin 2014; Nehorai & Paldi 1994 (bound); Gander, Golub & von Matt 1989,
"A constrained eigenvalue problem"; Moré & Sorensen 1983 (Newton's method on the secular equation, hard case).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

from sonobench.errors import InputError
from sonobench.geometry import angles
from sonobench.protocols import Directions
from sonobench.sphere import apart, in_angles, tangents
from sonobench.types import Array, Bools, Floats

Noise = Literal["moment", "eigen", "diagonal"]
Confidence = Literal["plug-in", "residuals", "none"]

#: least variance of noise, as a share of the power that the pressure and the velocities hold; keeps whitening finite where there is none
FLOOR = 1e-6
_NEWTON = 60
_CONVERGED = 1e-15
_SMALL = 1e-4  # a step of Fisher scoring that leaves an error of its square


class Solution(NamedTuple):
    """Directions u (…, 3), and M (…, 2, 4, 4), symmetric: δu = Σ M_ij δC_ij in arcs east and north (rad), to first order."""

    u: Array
    M: Array


def covariances(samples: Floats) -> Array:
    """Mean products (f, 4, 4) of frames (f, N, 4), about 0."""
    x = np.asarray(samples, np.float64)
    return np.asarray(np.swapaxes(x, -1, -2) @ x) / x.shape[-2]


def audible(C: Floats) -> Bools:
    """Whether covariances (…, 4, 4) show a direction at all (…,): pressure and velocity have something in common."""
    return np.asarray(np.any(np.asarray(C)[..., 1:, 0] != 0.0, axis=-1))


def coherent_share(C: Floats) -> Array:
    """Share of the energy (…,) that flows in one direction, 2 |c_vp| / (C_pp + tr C_vv), in [0, 1]; 0 in silence."""
    energy = np.trace(C, axis1=-2, axis2=-1)
    flow = 2.0 * np.linalg.norm(np.asarray(C)[..., 1:, 0], axis=-1)
    return np.divide(flow, energy, out=np.zeros_like(flow), where=energy > 0)


def mean_power(C: Floats) -> Array:
    """Mean variance of the four channels (…,), 1 in silence: what to scale by."""
    level = np.trace(C, axis1=-2, axis2=-1) / 4.0
    return np.asarray(np.where(level > 0, level, 1.0))


def noise_variances(C: Floats, rule: Noise = "moment", sources: int = 1) -> Array:
    """Variances of the noise of p, vx, vy, vz (…, 4), at least `FLOOR` of the mean power of a channel, and above 0 in silence.

    Args:
        C: (…, 4, 4).
        rule: "moment": σ_s² is |c_vp| of one source, what C_pp and tr C_vv hold beyond it is noise, equal in the three velocities. "eigen": the
            lowest 3 − `sources` eigenvalues of C_vv are σ_v². "diagonal": four variances, the likeliest with one source (`fitted`).
        sources: how many, for "eigen"; the others presume one.

    Raises:
        ValueError: no such rule.
    """
    C = np.asarray(C, float)
    if rule == "diagonal":
        return fitted(C).noise
    if rule not in ("moment", "eigen"):
        raise ValueError(f"noise is {rule!r}; 'moment', 'eigen' or 'diagonal' is needed")
    velocities = np.trace(C[..., 1:, 1:], axis1=-2, axis2=-1)
    if rule == "eigen":
        velocity = np.linalg.eigvalsh(C[..., 1:, 1:])[..., : 3 - sources].mean(axis=-1)
        source = velocities - 3.0 * velocity
    else:
        source = np.linalg.norm(C[..., 1:, 0], axis=-1)
        velocity = (velocities - source) / 3.0
    return _floored(np.stack([C[..., 0, 0] - source, velocity, velocity, velocity], axis=-1), C)


def _floored(variances: Floats, C: Floats) -> Array:
    least = FLOOR * np.trace(C, axis1=-2, axis2=-1)[..., None] / 4.0
    return np.asarray(np.maximum(variances, np.maximum(least, np.finfo(float).tiny)))


def maximiser(A: Floats, b: Floats) -> Array:
    """The unit vectors u (…, 3) at which uᵀAu + 2 bᵀu is highest, exactly: A (…, 3, 3) symmetric, b (…, 3).

    With A = VΛVᵀ and β = Vᵀb, u = V x, x_i = β_i / (t + λ_max − λ_i), where t ≥ 0 solves |x| = 1. Newton's method on 1/|x| runs up to t
    monotonically from its lower bound. In the hard case (b has nothing along the highest eigenvectors, and t = 0 leaves |x| < 1) the
    highest eigenvector makes up the rest; of two equal maxima the one in its stated direction is taken.
    """
    value, V = np.linalg.eigh(np.asarray(A, float))
    beta = np.einsum("...ij,...i->...j", V, np.asarray(b, float))
    gap = value[..., -1:] - value
    t = np.max(np.abs(beta) - gap, axis=-1, keepdims=True).clip(min=0.0)
    for _ in range(_NEWTON):
        shifted = t + gap
        x = np.divide(beta, shifted, out=np.zeros_like(beta), where=shifted > 0)
        square = np.sum(x * x, axis=-1, keepdims=True)
        slope = np.sum(np.divide(x * x, shifted, out=np.zeros_like(x), where=shifted > 0), axis=-1, keepdims=True)
        step = np.divide((np.sqrt(square) - 1.0) * square, slope, out=np.zeros_like(t), where=(slope > 0) & (square > 1.0))
        t = t + step
        if np.all(step <= _CONVERGED * t):
            break
    shifted = t + gap
    x = np.divide(beta, shifted, out=np.zeros_like(beta), where=shifted > 0)
    rest = 1.0 - np.sum(x * x, axis=-1)
    hard = (t[..., 0] == 0.0) & (rest > 0.0)
    x[..., -1] = np.where(hard, np.sqrt(np.maximum(rest, 0.0)), x[..., -1])
    u = np.einsum("...ij,...j->...i", V, x)
    return np.asarray(u / np.linalg.norm(u, axis=-1, keepdims=True))


def ascended(A: Floats, b: Floats, step: float, tolerance: float, most: int, renormalised: bool = True) -> Array:
    """Unit vectors (…, 3) that gradient ascent on uᵀAu + 2 bᵀu reaches from b: u ← u + step (A u + b), again and again.

    Args:
        A, b: (…, 3, 3) and (…, 3).
        step: of the gradient.
        tolerance: a vector that moves by less stops; without renormalisation none does.
        most: iterations.
        renormalised: whether u has length 1 in every iteration. Without, it grows without end, forgets b, and its direction drifts to the
            highest eigenvector of A.
    """
    A, b = np.asarray(A, float), np.asarray(b, float)
    u = _unit(b)
    length = np.ones((*u.shape[:-1], 1))
    going = np.ones(length.shape, bool)
    for _ in range(most):
        there = u + step * (np.einsum("...ij,...j->...i", A, u) + b / length)
        if not renormalised:
            length = length * np.linalg.norm(there, axis=-1, keepdims=True)  # u stands for length · u, which would overflow
        there = _unit(there)
        moved = np.linalg.norm(there - u, axis=-1, keepdims=True)
        u = np.where(going, there, u)
        going = going & ((moved >= tolerance) | (not renormalised))
        if not going.any():
            break
    return u


def _unit(v: Floats) -> Array:
    """v over its length; (1, 0, 0) for 0."""
    length = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 0, v / np.where(length > 0, length, 1.0), np.array([1.0, 0.0, 0.0])), float)


def axes(u: Floats) -> Array:
    """East and north at unit vectors (…, 3) as the rows of (…, 2, 3)."""
    return tangents(angles(u))


def sensitivity(u: Floats, A: Floats, b: Floats, left: Floats, right: Floats) -> Array:
    """M (…, 2, 4, 4) of the maximiser u of uᵀAu + 2 bᵀu, where the gradient's half A u + b changes by left · δC · right.

    left (…, 3, 4), right (…, 4). From the curvature along the sphere, μ I − A with μ = uᵀ(A u + b).
    """
    T = axes(u)
    slope = np.einsum("...ij,...j->...i", A, u) + b
    mu = np.sum(u * slope, axis=-1)[..., None, None]
    curvature = mu * np.eye(2) - T @ A @ np.swapaxes(T, -1, -2)
    gain = np.linalg.pinv(curvature, hermitian=True) @ T @ left
    return symmetric(gain[..., :, :, None] * np.asarray(right)[..., None, None, :])


def symmetric(M: Array) -> Array:
    """The symmetric part of M (…, d, d)."""
    return np.asarray(0.5 * (M + np.swapaxes(M, -1, -2)))


def spread(M: Floats, C: Floats, snapshots: float) -> Array:
    """Covariances (…, 2, 2), arcs east and north, of what is M : δC of the sample covariance of that many Gaussian snapshots.

    cov(M_a : δC, M_b : δC) = 2 tr(M_a C M_b C) / N, M symmetric.
    """
    turned = np.asarray(M) @ np.asarray(C)[..., None, :, :]
    return np.asarray(2.0 * np.einsum("...aij,...bji->...ab", turned, turned) / snapshots)


def msae(alpha: Floats | float, source: float, pressure: float, velocity: float, snapshots: float) -> Array:
    """Mean squared angular error (rad²) of maximum power with weight alpha (…,), to first order; all others are variances.

    2 σ_v² (σ_s² + α² σ_p² + (1 − α)² σ_v²) / (N σ_s⁴), least, and the Cramér-Rao bound, at α = σ_v² / (σ_p² + σ_v²).
    """
    alpha = np.asarray(alpha, float)
    return np.asarray(2.0 * velocity * (source + alpha**2 * pressure + (1.0 - alpha) ** 2 * velocity) / (snapshots * source**2))


def best_alpha(variances: Floats) -> Array:
    """σ_v² / (σ_p² + σ_v²) (…,) of variances (…, 4), σ_v² the mean of the three velocities'."""
    velocity = np.asarray(variances)[..., 1:].mean(axis=-1)
    return np.asarray(velocity / (np.asarray(variances)[..., 0] + velocity))


def found(samples: Floats, solve: Callable[[Array], Solution], confidence: Confidence, blocks: int) -> Directions:
    """One direction a frame (f, N, 4) by an estimator of covariances, with R of (azimuth, elevation) and the coherent share as score.

    Args:
        samples: (f, N, 4).
        solve: covariances (…, 4, 4) → directions and sensitivities.
        confidence: "plug-in": R from the sensitivity and the frame's own covariance, for Gaussian snapshots that do not depend on each
            other. "residuals": the estimates of `blocks` equal parts of the frame about their mean, their sample covariance over their
            number. "none": no R.
        blocks: at least 2.

    Raises:
        InputError: a frame has fewer than 4 samples a block.
    """
    C = covariances(samples)
    one = solve(C)
    R = None
    if confidence == "plug-in":
        R = spread(one.M, C, np.shape(samples)[1])
    elif confidence == "residuals":
        R = _of_residuals(samples, one.u, solve, blocks)
    if R is not None:
        R = in_angles(R, angles(one.u))[:, None]
    return Directions(one.u[:, None], audible(C)[:, None], R, coherent_share(C)[:, None])


def _of_residuals(samples: Floats, u: Array, solve: Callable[[Array], Solution], blocks: int) -> Array:
    """Covariances (f, 2, 2), arcs, of frames' directions u (f, 3) from those of their blocks."""
    f, n, _ = np.shape(samples)
    length = n // blocks
    if length < 4:
        raise InputError(f"confidence 'residuals' cuts frames of {n} samples into {blocks} blocks; 4 samples a block are needed")
    parts = np.asarray(samples)[:, : blocks * length].reshape(f * blocks, length, 4)
    there = solve(covariances(parts)).u.reshape(f, blocks, 3)
    step = apart(angles(there), angles(u)[:, None])
    step = step - step.mean(axis=1, keepdims=True)
    return np.einsum("fbi,fbj->fij", step, step) / ((blocks - 1) * blocks)


class Fit(NamedTuple):
    """One source in noise of four variances, the likeliest: u (…, 3), source (…,), noise (…, 4).

    M (…, 7, 4, 4), symmetric, are the sensitivities to δC of arcs east and north and of the logarithms of source and noise.
    """

    u: Array
    source: Array
    noise: Array
    M: Array


def fitted(C: Floats, steps: int = 12) -> Fit:
    """Maximum likelihood of C = σ_s² a aᵀ + diag(q) for Gaussian snapshots, by Fisher scoring from the moments.

    A step that does not raise the likelihood ends a frame's scoring, so the worst answer is that of the moments: the intensity's direction.
    """
    C = np.asarray(C, float)
    level = mean_power(C)
    C = C / level[..., None, None] + FLOOR * np.eye(4)
    u = _unit(C[..., 1:, 0])
    source = np.maximum(np.linalg.norm(C[..., 1:, 0], axis=-1, keepdims=True), FLOOR)
    held = np.concatenate([source, source * u * u], axis=-1)
    power = np.log(np.concatenate([source, _floored(np.einsum("...ii->...i", C) - held, C)], axis=-1))
    model, gain = _scoring(u, power)
    likelihood = _likelihood(model, C)
    going = np.ones(likelihood.shape, bool)
    for _ in range(steps):
        step = np.einsum("...iab,...ab->...i", gain, C - model).clip(-1.0, 1.0)
        there, level_there = _unit(u + np.einsum("...i,...ij->...j", step[..., :2], axes(u))), power + step[..., 2:]
        trial, trial_gain = _scoring(there, level_there)
        value = _likelihood(trial, C)
        better = going & (value > likelihood)
        u, power = np.where(better[..., None], there, u), np.where(better[..., None], level_there, power)
        pick = better[..., None, None]
        model, gain = np.where(pick, trial, model), np.where(pick[..., None], trial_gain, gain)
        likelihood, going = np.where(better, value, likelihood), better & (np.abs(step).max(axis=-1) > _SMALL)
        if not going.any():
            break
    scale = np.exp(power) * level[..., None]
    return Fit(u, scale[..., 0], scale[..., 1:], gain / level[..., None, None, None])


def _scoring(u: Array, power: Array) -> tuple[Array, Array]:
    """Covariances (…, 4, 4) of directions (…, 3) and logarithms of powers (…, 5), and gain (…, 7, 4, 4): a step is gain : (C − model)."""
    a = np.concatenate([np.ones((*u.shape[:-1], 1)), u], axis=-1)
    across = np.concatenate([np.zeros((*u.shape[:-1], 2, 1)), axes(u)], axis=-1)
    power = np.exp(power)
    outer = power[..., :1, None] * a[..., :, None] * a[..., None, :]
    model = outer + power[..., 1:, None] * np.eye(4)
    turned = power[..., :1, None, None] * across[..., :, :, None] * a[..., None, None, :]
    noise = power[..., 1:, None, None] * (np.eye(4)[:, :, None] * np.eye(4)[:, None, :])
    D = np.concatenate([turned + np.swapaxes(turned, -1, -2), outer[..., None, :, :], noise], axis=-3)
    inverse = np.linalg.inv(model)[..., None, :, :]
    pulled = inverse @ D @ inverse
    flat = D.reshape(*D.shape[:-2], 16)
    information = np.swapaxes(flat @ np.swapaxes(pulled.reshape(flat.shape), -1, -2), -1, -2)
    gain = np.linalg.solve(information + 1e-12 * np.eye(7), pulled.reshape(flat.shape))
    return model, gain.reshape(D.shape)


def _likelihood(model: Array, C: Floats) -> Array:
    """2 / N times the log-likelihood (…,), less a constant."""
    return np.asarray(-np.linalg.slogdet(model)[1] - np.einsum("...ij,...ji->...", np.linalg.inv(model), C))


def with_noise_error(M: Array, fit: Fit) -> Array:
    """M (…, 2, 4, 4) of an estimator that whitens by a fit's noise, whose own errors then count to first order: M : (δC − diag δq).

    Noise that is taken to be equal in the three velocities has no such term: its error turns nothing.
    """
    weight = np.einsum("...ii->...i", M) * fit.noise[..., None, :]
    return np.asarray(M - np.einsum("...ai,...ijk->...ajk", weight, fit.M[..., 3:, :, :]))
