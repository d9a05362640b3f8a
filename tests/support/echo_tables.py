"""Correlations of one pair with echoes, made up: peaks at the delays of talkers' modes in noise of known deviation."""

from __future__ import annotations

import numpy as np
from echo_scans import REACH_S, five_modes, setup

from sonobench.types import Array, DelayTable, Scan, Setup

RATE_HZ = 8000.0
_STEP_S = 0.25 / RATE_HZ


def table(points: Array, rng: np.random.Generator, height: float = 0.3, noise: float = 0.03, where: Setup | None = None) -> DelayTable:
    """Triangles two samples wide at the five delays of each point (n, 4), the highest where several fall together, and noise."""
    where = setup() if where is None else where
    model = five_modes(where)
    lags = _STEP_S * np.arange(round(2 * REACH_S / _STEP_S) + 1) - REACH_S
    values = np.zeros((len(where.sensors), len(lags)), np.float32)
    for q in model.sensors:
        delays = model.h(points, q)[..., 0].ravel()
        peaks = np.maximum(1.0 - np.abs(lags[:, None] - delays) * RATE_HZ, 0.0)
        coarse = noise * rng.standard_normal(len(lags) // 4 + 2)  # independent from sample to sample, as a correlation's noise is
        values[q] = height * peaks.max(axis=1, initial=0.0) + np.interp(np.arange(len(lags)) / 4, np.arange(len(coarse)), coarse)
    return DelayTable(values, -REACH_S, _STEP_S)


def field_scan(time_s: float, points: Array, rng: np.random.Generator, **more: float) -> Scan:
    """A scan that offers the table only."""
    return Scan(time_s, np.ones(1, bool), (), {"gcc": table(points, rng, **more)})
