"""MUSIC on one vector sensor: one or two sources where a = [1; u] comes nearest to the subspace that they span in the covariance.

The null spectrum aᵀ P a, P the projector on the noise subspace, is a quadratic on the sphere: one source is its exact minimum. Two sources
span S (4, 2), and S c is some a wherever |S_v c|² = (S_p c)²; with |c| = 1 and p = S_p that is (p c)² = 1/2, so c lies at ± arccos(1 / √2 |p|)
from p: both peaks in closed form, at which the spectrum is infinite. Where |p|² < 1/2 noise has pulled the two into one, and only the
minimum is left. One sensor cannot hold more than two: any three directions share a cone.
Source: Schmidt 1986; Wong & Zoltowski 2000; for two sources of one sensor Hochwald & Nehorai 1996, "Identifiability in array processing
models with vector-sensor applications".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.geometry import angles
from sonobench.protocols import Directions
from sonobench.signal.vector_sensor import (
    audible,
    axes,
    coherent_share,
    covariances,
    maximiser,
    mean_power,
    noise_variances,
    spread,
    symmetric,
)
from sonobench.sphere import in_angles
from sonobench.types import Array, Bools, Floats


@dataclass(frozen=True)
class Music:
    """Up to two sources."""

    sources: int = 1  #: 1 or 2
    noise: Literal["equal", "eigen"] = (
        "equal"  #: noise of the channels: "equal", or "eigen" (the pressure's against the velocities', found and whitened)
    )
    confidence: Literal["plug-in", "none"] = "plug-in"  #: R by "plug-in" of the frame's covariance, or "none"

    def __post_init__(self) -> None:
        if self.sources not in (1, 2):
            raise ValueError(f"sources is {self.sources}; 1 or 2 is needed: the covariance of one vector sensor holds no more")

    def directions(self, samples: Floats) -> Directions:
        """Frames (f, N, 4) → `sources` directions each, the stronger first; the score is each one's share of the energy that flows."""
        C = covariances(samples)
        S, power = self._subspace(C)
        u, valid = _peaks(S) if self.sources == 2 else _lowest(S)
        strength = _strengths(u, valid, C)
        rows, order = np.arange(len(C))[:, None], np.argsort(-np.where(valid, strength, -np.inf), axis=1, kind="stable")
        u, valid, strength = u[rows, order], valid[rows, order], strength[rows, order]
        R = None
        if self.confidence == "plug-in":
            R = in_angles(spread(_sensitivity(u, S, power), C[:, None], np.shape(samples)[1]), angles(u))
        energy = np.trace(C, axis1=-2, axis2=-1)[:, None]
        score = (
            coherent_share(C)[:, None]
            if self.sources == 1
            else np.divide(2.0 * strength, energy, out=np.zeros_like(strength), where=energy > 0)
        )
        return Directions(u, valid & audible(C)[:, None], R, score)

    def _subspace(self, C: Array) -> tuple[Array, Array]:
        """Orthonormal S (f, 4, m) of the sources, and what stands for their part of C⁻¹: G (f, 4, 4), the pseudo-inverse of C − Q on S."""
        m = self.sources
        level = mean_power(C)[:, None]
        q = np.sqrt(noise_variances(C, "eigen", m)) if self.noise == "eigen" else np.sqrt(np.broadcast_to(level, (len(C), 4)))
        value, vector = np.linalg.eigh(C / (q[:, :, None] * q[:, None, :]))
        noise = value[:, : 4 - m].mean(axis=1)[:, None]
        S = np.linalg.qr(q[:, :, None] * vector[:, :, 4 - m :])[0]
        raw = q[:, :, None] * vector[:, :, 4 - m :]
        signal = (raw * (value[:, 4 - m :] - noise)[:, None, :]) @ np.swapaxes(raw, 1, 2)
        return S, np.linalg.pinv(signal, rcond=1e-9, hermitian=True)


def _quadratic(S: Array) -> tuple[Array, Array]:
    """A (f, 3, 3) and b (f, 3) of what is to be made highest: |Sᵀ a|²."""
    P = S @ np.swapaxes(S, 1, 2)
    return P[:, 1:, 1:], P[:, 1:, 0]


def _lowest(S: Array) -> tuple[Array, Bools]:
    """The minimum of the null spectrum u (f, 1, 3), valid (f, 1)."""
    return maximiser(*_quadratic(S))[:, None], np.ones((len(S), 1), bool)


def _peaks(S: Array) -> tuple[Array, Bools]:
    """Both directions u (f, 2, 3) of subspaces S (f, 4, 2), and which are valid (f, 2)."""
    p = S[:, 0]
    length = np.linalg.norm(p, axis=1)
    apart = length > np.sqrt(0.5)
    along = p / np.where(length > 0, length, 1.0)[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    cosine = np.sqrt(0.5) / np.where(apart, length, 1.0)
    sine = np.sqrt(1.0 - cosine**2)
    c = cosine[:, None, None] * along[:, None] + np.stack([sine, -sine], axis=1)[..., None] * across[:, None]
    two = np.sqrt(2.0) * np.einsum("fij,fkj->fki", S[:, 1:], c)
    u = np.where(apart[:, None, None], two, _lowest(S)[0])
    return u, np.stack([np.ones_like(apart), apart], axis=1)


def _strengths(u: Array, valid: Bools, C: Array) -> Array:
    """Powers (f, n) of the sources such that c_vp = Σ s u, by least squares, at least 0."""
    held = np.where(valid[..., None], u, 0.0)
    return np.maximum(np.einsum("fni,fi->fn", np.swapaxes(np.linalg.pinv(held), 1, 2), C[:, 1:, 0]), 0.0)


def _sensitivity(u: Array, S: Array, G: Array) -> Array:
    """M (f, n, 2, 4, 4): δu = −(Tᵀ P T)⁻¹ Tᵀ P · δC · G a, P the noise projector, T the axes across u (Stoica & Nehorai 1989)."""
    P = (np.eye(4) - S @ np.swapaxes(S, 1, 2))[:, None]
    T = np.concatenate([np.zeros((*u.shape[:-1], 2, 1)), axes(u)], axis=-1)
    a = np.concatenate([np.ones((*u.shape[:-1], 1)), u], axis=-1)
    gain = np.linalg.pinv(T @ P @ np.swapaxes(T, -1, -2), hermitian=True) @ T @ P
    right = np.einsum("fij,fnj->fni", G, a)
    return symmetric(gain[..., :, :, None] * right[..., None, None, :])
