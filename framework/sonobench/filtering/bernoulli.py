"""The Bernoulli filter's probability of existence: at most one target, which may appear, vanish, or not be there.

Source: Ristic, Vo, Vo & Farina 2013, "A tutorial on Bernoulli filters", the update for likelihoods of whole scans.
"""

from __future__ import annotations

import numpy as np

from sonobench.types import Array


def updated(absent: float, log_w: Array, log_ratio: Array) -> tuple[float, Array]:
    """Existence given a scan, and the log weights of particles (n,), which sum to it.

    Args:
        absent: prior probability that there is no target.
        log_w: log weights (n,) that sum to the prior existence, 1 − absent.
        log_ratio: log p(scan | target at the particle) − log p(scan | no target).
    """
    log_w = log_w + log_ratio
    top = max(float(np.max(log_w, initial=-np.inf)), float(np.log(absent)) if absent > 0 else -np.inf)
    if not np.isfinite(top):
        raise ValueError("no particle and no probability of absence explain the scan; every weight is zero")
    there = float(np.exp(log_w - top).sum())
    log_total = top + np.log(there + absent * np.exp(-top))
    return there * float(np.exp(top - log_total)), log_w - log_total
