"""Sources that move by constant rates before one vector sensor, as plain arrays: no scene, no recording."""

import numpy as np

from sonobench.geometry import unit_vector
from sonobench.types import Truth


def drawn(rng, n, low_deg, high_deg, frames):
    """Truth of n sources of random rates whose least separation, half way, lies between two angles; frames of 1 s."""
    while True:
        z = np.stack([rng.uniform(-np.pi, np.pi, n), rng.uniform(-1.0, 1.0, n)], axis=1)
        u = unit_vector(z)
        least = np.degrees(np.arccos(np.clip((u @ u.T)[np.triu_indices(n, 1)], -1, 1))).min()
        if low_deg <= least < high_deg:
            break
    rates = np.radians(rng.uniform(-0.3, 0.3, (n, 2)))
    time_s = np.arange(1.0, frames + 1)
    path = z + (time_s - time_s.mean())[:, None, None] * rates
    there = np.ones((frames, n), bool)
    return Truth(time_s, np.arange(n), 50 * unit_vector(path), there, there, period_s=1.0, parameters={f"origin_{a}_m": 0.0 for a in "xyz"})


def snapshots(rng, truth, k, samples=10_000, snr_db=10.0):
    """(1, samples, 4) of uniform sources of unit variance, each snr_db above the noise of a channel."""
    u = truth.position[k] / np.linalg.norm(truth.position[k], axis=-1, keepdims=True)
    s = rng.uniform(-np.sqrt(3), np.sqrt(3), (samples, len(u)))
    y = s @ np.concatenate([np.ones((len(u), 1)), u], axis=1)
    return (y + 10 ** (-snr_db / 20) * rng.standard_normal(y.shape))[None]
