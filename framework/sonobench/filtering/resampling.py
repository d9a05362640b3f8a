"""Resampling of weighted particles."""

from __future__ import annotations

import numpy as np

from sonobench.types import Array, Ints


def systematic(rng: np.random.Generator, w: Array, n: int) -> Ints:
    """Indices (n,) drawn with one uniform number: particle i comes ⌊n wᵢ⌋ or ⌈n wᵢ⌉ times (w need not sum to 1).

    Raises:
        ValueError: the weights sum to zero or are not finite.
    """
    total = np.sum(w)
    if not (np.isfinite(total) and total > 0):
        raise ValueError(f"weights that sum to {total} cannot be resampled")
    edges = np.cumsum(w) / total
    edges[-1] = 1.0
    return np.searchsorted(edges, (np.arange(n) + rng.random()) / n, side="right").astype(np.int64)
