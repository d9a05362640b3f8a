"""States of directions that move: azimuth and elevation with their rates and, where wanted, accelerations; linear motion of such states.

Angles move like the coordinates of a plane, and come back into their range afterwards (`settled`): azimuth to [−π, π), and who has
climbed over a pole comes down on the other side, at the azimuth turned by π with the rates of elevation reversed.
"""

from __future__ import annotations

import math

import numpy as np

from sonobench.filtering.gaussian import log_degenerate
from sonobench.filtering.kinematics import linear_sample
from sonobench.types import Array, Floats, Space

_AXES = ("azimuth", "elevation")
_ENDINGS = ("rad", "rad_s", "rad_s2")


def bearing_space(accelerations: bool) -> Space:
    """azimuth_rad azimuth_rad_s [azimuth_rad_s2] elevation_rad elevation_rad_s [elevation_rad_s2]."""
    endings = _ENDINGS[: 3 if accelerations else 2]
    return Space.of(*(f"{axis}_{ending}" for axis in _AXES for ending in endings))


def settled(x: Floats) -> tuple[Array, Array]:
    """States (…, d) of a `bearing_space` with their angles in range, and the signs (…, d) that coordinates were multiplied by for it."""
    x = np.array(x, float)
    n = x.shape[-1] // 2
    turned = x[..., n] - 2 * math.pi * np.floor(x[..., n] / (2 * math.pi) + 0.5)
    over = np.abs(turned) > math.pi / 2
    sign = np.ones(x.shape)
    sign[..., n:] = np.where(over, -1.0, 1.0)[..., None]
    azimuth = x[..., 0] + np.where(over, math.pi, 0.0)
    x[..., n:] *= sign[..., n:]
    x[..., n] = np.where(over, np.copysign(math.pi, turned) - turned, turned)
    x[..., 0] = azimuth - 2 * math.pi * np.floor(azimuth / (2 * math.pi) + 0.5)
    return np.asarray(x), np.asarray(sign, np.float64)


def bearing_moments(x: Array, P: Array, F: Array, Q: Array) -> tuple[Array, Array]:
    """Settled F m and F P Fᵀ + Q of Gaussians (n, d), (n, d, d)."""
    m, sign = settled(x @ F.T)
    return m, (F @ P @ F.T + Q) * sign[:, :, None] * sign[:, None, :]


def bearing_sample(rng: np.random.Generator, x: Array, F: Array, Q: Array) -> Array:
    """A settled draw of N(F x, Q) for each particle (n, d); Q may be degenerate."""
    return settled(linear_sample(rng, x, F, Q))[0]


def bearing_log_density(x1: Array, x0: Array, F: Array, Q: Array) -> Array:
    """log p(x1 | x0) (n,), by the nearer of the two ways in which x1 may have been reached, straight or over a pole.

    Other ways (a whole turn more) are left out: they matter where the noise of one step spans half the sphere. −inf off the
    support of a degenerate Q (see `log_degenerate`).
    """
    space = bearing_space(x1.shape[-1] == 6)
    m, n = x0 @ F.T, x1.shape[-1] // 2
    over = np.array(x1)
    over[:, n:] *= -1
    over[:, n] += math.pi
    over[:, 0] += math.pi
    magnitude = np.max(np.abs(x1), axis=-1, initial=0.0) + np.max(np.abs(x0), axis=-1, initial=0.0) + math.pi
    full = Space(space.names, tuple(2 * math.pi if name.endswith("_rad") else 0.0 for name in space.names))
    straight, across = (log_degenerate(np.asarray(full.residual(a, m), np.float64), Q, magnitude) for a in (x1, over))
    return np.asarray(np.maximum(straight, across))


def held_still(F: Array, Q: Array, dt_s: float) -> tuple[Array, Array]:
    """F and Q, or identity and zero where no time passes (a model that redraws accelerations would do so at once)."""
    return (F, Q) if dt_s > 0 else (np.eye(len(F)), np.zeros_like(Q))


def blocks(block: Array) -> Array:
    """The block-diagonal matrix (2 k, 2 k) of one axis's (k, k) block, for azimuth and for elevation."""
    return np.asarray(np.kron(np.eye(2), block), np.float64)
