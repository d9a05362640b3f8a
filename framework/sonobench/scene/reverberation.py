"""The reflection coefficient that gives a box a stated reverberation time.

In the image method with six walls of reflection coefficient b, sound that arrives at time t from direction u has met
n(u, t) = c t (|u_x| / L_x + |u_y| / L_y + |u_z| / L_z) walls. The images' density cancels their spreading, so the energy
that arrives is the mean of b^(2 n) over directions, and Schroeder's integral of it has a closed form. T60 is twice
the time between −5 and −35 dB of that decay, as ISO 3382 reads it. Eyring's formula is some 25 % off here, since a
box's field is not diffuse.

Source: Lehmann & Johansson 2008, "Prediction of energy decay in room impulse responses simulated with an image-source
model"; the mean over directions is taken by quadrature instead of their approximation.
"""

from __future__ import annotations

import math

import numpy as np

from sonobench.types import Array

_DIRECTIONS = 48


def decay_time(size_m: Array, reflection: float, c_m_s: float) -> float:
    """T60 (s) of a box (3,) m with six walls of one pressure reflection coefficient in (0, 1)."""
    rate = -2 * math.log(reflection) * c_m_s * _walls_per_metre(size_m)  # (u,) energy falls as exp(−rate t)
    weight = _weights() / rate  # of the integral from t to infinity
    weight = weight / weight.sum()

    def time_at(level_db: float) -> float:
        target, low, high = 10 ** (level_db / 10), 0.0, -level_db / 10 * math.log(10) / rate.min()
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if np.sum(weight * np.exp(-rate * middle)) > target else (low, middle)
        return low

    return 2 * (time_at(-35.0) - time_at(-5.0))


def uniform_reflection(size_m: Array, t60_s: float, c_m_s: float) -> float:
    """The pressure reflection coefficient of six equal walls that gives a box (3,) m this T60.

    Raises:
        ValueError: the time is not positive.
    """
    if not 0 < t60_s < math.inf:
        raise ValueError(f"t60_s is {t60_s}; a positive time is needed (leave the room out for free field)")
    return math.exp(-decay_time(size_m, math.exp(-1.0), c_m_s) / t60_s)  # T60 is inversely proportional to −log b


def _quadrature() -> tuple[Array, Array, Array, Array]:
    node, weight = np.polynomial.legendre.leggauss(_DIRECTIONS)
    return 0.5 * (node + 1), 0.5 * weight, np.pi / 4 * (node + 1), 0.5 * weight


def _walls_per_metre(size_m: Array) -> Array:
    height, _, azimuth, _ = _quadrature()  # equal areas: the height on the unit sphere is uniform
    across = np.sqrt(1 - height**2)[:, None]
    rate = across * np.cos(azimuth) / size_m[0] + across * np.sin(azimuth) / size_m[1] + height[:, None] / size_m[2]
    return np.asarray(rate.ravel())


def _weights() -> Array:
    _, a, _, b = _quadrature()
    return np.asarray(np.outer(a, b).ravel())
