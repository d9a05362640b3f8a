"""Random tracks as truth and labelled estimates, for the metrics that know labels."""

from __future__ import annotations

import numpy as np

from sonobench.types import Estimate, Space, Truth

SPACE = Space.of("x_m", "y_m")


def made(truth, found):
    """(Truth, estimates) of {label: {frame: (x, y)}} on both sides; frames are seconds, 1 on."""
    last = max((k for side in (truth, found) for track in side.values() for k in track), default=1)
    times = np.arange(1.0, last + 1)
    names = sorted(truth)
    position, exists = np.zeros((len(times), len(names), 3)), np.zeros((len(times), len(names)), bool)
    for n, name in enumerate(names):
        for k, point in truth[name].items():
            position[k - 1, n, :2], exists[k - 1, n] = point, True
    estimates = []
    for k in range(1, len(times) + 1):
        rows = [(name, track[k]) for name, track in found.items() if k in track]
        estimates.append(
            Estimate(float(k), np.array([p for _, p in rows], float).reshape(-1, 2), labels=np.array([n for n, _ in rows], int))
        )
    return Truth(times, np.array(names, int), position, exists, exists, period_s=1.0), estimates


def random(rng: np.random.Generator, tracks: int, frames: int = 8, present: float = 0.7):
    """{label: {frame: (x, y)}} of up to `tracks` tracks in a unit square, each there in some frames."""
    every = {int(n): {k: tuple(rng.random(2)) for k in range(1, frames + 1) if rng.random() < present} for n in range(tracks)}
    return {n: track for n, track in every.items() if track}
