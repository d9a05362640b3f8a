"""Loops that NumPy would run through memory several times (compiled on first use)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(cache=True)
def unit_phase(x: Any, out: Any) -> None:  # pragma: no cover - compiled
    """out = x / |x|, 0 where x is 0; both (n, bins) complex64."""
    for a in range(x.shape[0]):
        for b in range(x.shape[1]):
            re, im = x[a, b].real, x[a, b].imag
            power = re * re + im * im
            scale = np.float32(1.0) / np.sqrt(power) if power > np.float32(0.0) else np.float32(0.0)
            out[a, b] = complex(re * scale, im * scale)


@njit(cache=True)
def cross(x: Any, pairs: Any, out: Any) -> None:  # pragma: no cover - compiled
    """out[n, p] = x[n, i] conj(x[n, j]) of pairs (P, 2); x (n, mics, bins), out (n, P, bins)."""
    for a in range(x.shape[0]):
        for p in range(pairs.shape[0]):
            i, j = pairs[p, 0], pairs[p, 1]
            for b in range(x.shape[2]):
                out[a, p, b] = x[a, i, b] * x[a, j, b].conjugate()


@njit(cache=True)
def interpolate(circular: Any, reach: int, taps: Any, scale: float, out: Any) -> None:  # pragma: no cover - compiled
    """Lags −reach … reach of circular correlations (n, lags) at `phases` points a lag, by FIR taps (phases, 2 half).

    Tap t of phase f weighs the lag (t − half + 1) steps from the output's own; out is (n, 2 reach phases + 1).
    """
    phases, width = taps.shape
    half, lags = width // 2, circular.shape[1]
    line = np.empty(2 * reach + width, circular.dtype)
    for row in range(circular.shape[0]):
        for k in range(line.size):
            line[k] = circular[row, (k - reach - half + 1) % lags]
        for lag in range(2 * reach + 1):
            for f in range(phases if lag < 2 * reach else 1):
                total = np.float32(0.0)
                for t in range(width):
                    total += taps[f, t] * line[lag + t]
                out[row, lag * phases + f] = total * scale


@njit(cache=True)
def look_up(tables: Any, column: Any, out: Any) -> None:  # pragma: no cover - compiled
    """out (points,) = sum over pairs of tables (P, lags) at columns (P, points)."""
    out[:] = 0.0
    for p in range(column.shape[0]):
        for g in range(column.shape[1]):
            out[g] += tables[p, column[p, g]]


@njit(cache=True)
def steer(tables: Any, elements: Any, pairs: Any, points: Any, place: Any, out: Any) -> None:  # pragma: no cover - compiled
    """out (n,) = sum over pairs of tables (P, lags), linearly interpolated at the delays of points (n, 3); 0 outside a table.

    `place` is (columns per metre of path difference, column of delay 0).
    """
    lags, far = tables.shape[1], np.empty(len(elements))
    for n in range(len(points)):
        for m in range(len(elements)):
            dx, dy, dz = points[n, 0] - elements[m, 0], points[n, 1] - elements[m, 1], points[n, 2] - elements[m, 2]
            far[m] = np.sqrt(dx * dx + dy * dy + dz * dz)
        total = 0.0
        for p in range(len(pairs)):
            column = (far[pairs[p, 0]] - far[pairs[p, 1]]) * place[0] + place[1]
            if 0.0 <= column <= lags - 1:
                low = min(int(column), lags - 2)
                left = tables[p, low]
                total += left + (column - low) * (tables[p, low + 1] - left)
        out[n] = total
