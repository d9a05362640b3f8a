"""Snapshots of a vector sensor, and their sample covariances, drawn directly."""

from __future__ import annotations

from typing import Any

import numpy as np

from sonobench.geometry import unit_vector

#: the direction, the power of the source and the variances of the noise in Hu, Li & Jin 2014, 4.1
Z = np.radians([30.0, 30.0])
SOURCE = 10.0**0.5
NOISE = np.array([1.5, 0.5, 0.5, 0.5])
#: noise of other variances in each velocity
UNEQUAL = np.array([1.5, 0.2, 0.5, 1.0])


def model(z: Any = Z, source: float = SOURCE, noise: Any = NOISE) -> Any:
    """Covariance (4, 4)."""
    a = np.concatenate([[1.0], unit_vector(z)])
    return source * np.outer(a, a) + np.diag(noise)


def snapshots(rng: np.random.Generator, frames: int, n: int, z: Any = Z, source: float = SOURCE, noise: Any = NOISE) -> Any:
    """(frames, n, 4) of a Gaussian source, read-only."""
    a = np.concatenate([[1.0], unit_vector(z)])
    x = source**0.5 * rng.standard_normal((frames, n, 1)) * a + rng.standard_normal((frames, n, 4)) * np.sqrt(noise)
    x.flags.writeable = False
    return x


def sample_covariances(rng: np.random.Generator, frames: int, n: int, covariance: Any) -> Any:
    """(frames, 4, 4) of n Gaussian snapshots each, without drawing the snapshots (Bartlett 1933)."""
    low = np.zeros((frames, 4, 4))
    for i in range(4):
        low[:, i, i] = np.sqrt(rng.chisquare(n - i, frames))
        low[:, i, :i] = rng.standard_normal((frames, i))
    root = np.linalg.cholesky(covariance) @ low
    C = root @ np.swapaxes(root, 1, 2) / n
    C.flags.writeable = False
    return C
