"""Sources around one vector sensor, without a recording."""

from __future__ import annotations

import numpy as np

#: how noise of a mean variance of 1 comes on (p, vx, vy, vz)
NOISES = {
    "equal": np.eye(4),
    "unequal": np.diag([2.8, 0.4, 0.4, 0.4]) ** 0.5,
    "non-uniform": np.diag([1.0, 2.6, 0.3, 0.1]) ** 0.5,
    "correlated": np.linalg.cholesky(0.3 * np.eye(4) + 0.7 * np.outer([1, 1, -1, 1], [1, 1, -1, 1])),
}


def spread(rng: np.random.Generator, m: int, apart_deg: float) -> np.ndarray:
    """m unit vectors (m, 3) from anywhere, at least so far from each other."""
    while True:
        u = rng.normal(size=(m, 3))
        u /= np.linalg.norm(u, axis=1, keepdims=True)
        if m < 2 or (u @ u.T - 2 * np.eye(m)).max() < np.cos(np.radians(apart_deg)):
            return u


def heard(rng: np.random.Generator, u: np.ndarray, n: int = 10_000, snr_db: float = 10.0, noise: str = "equal") -> np.ndarray:
    """(n, 4): uniform sources of variance 1 from u (m, 3) in Gaussian noise."""
    s = rng.uniform(-(3**0.5), 3**0.5, (n, len(u)))
    hiss = rng.standard_normal((n, 4)) @ NOISES[noise].T
    return s @ np.concatenate([np.ones((len(u), 1)), u], axis=1) + 10 ** (-snr_db / 20) * hiss


def errors(u: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Angles (m,) in degrees from each true direction to the one that the best assignment gives it; 180 where there is none."""
    from scipy.optimize import linear_sum_assignment

    off = np.full(len(u), 180.0)
    if len(found):
        far = np.degrees(np.arccos(np.clip(u @ found.T, -1, 1)))
        rows, columns = linear_sum_assignment(far)
        off[rows] = far[rows, columns]
    return off
