"""Peaks of sampled curves, with sub-sample interpolation."""

from __future__ import annotations

import numpy as np

from sonobench.types import Array, Bools, Floats, Ints


def local_maxima(curves: Floats) -> Bools:
    """Which samples of curves (…, k) rise above their left and reach their right neighbour; never the two ends."""
    out = np.zeros(curves.shape, bool)
    middle = curves[..., 1:-1]
    out[..., 1:-1] = (middle > curves[..., :-2]) & (middle >= curves[..., 2:])
    return out


def refine(left: Floats, middle: Floats, right: Floats) -> tuple[Array, Array]:
    """Offset in samples, within ±1/2, and height of the parabola through a local maximum and its neighbours."""
    bend = np.asarray(left, float) - 2.0 * np.asarray(middle, float) + right
    slope = np.asarray(left, float) - right
    offset = np.divide(0.5 * slope, bend, out=np.zeros_like(bend), where=bend < 0.0)
    return offset, middle - 0.25 * slope * offset


def pick(curves: Floats, allowed: Bools, least: Floats, most: int) -> tuple[Ints, Array, Array]:
    """The highest peaks of several curves.

    Args:
        curves: (P, k).
        allowed: (P, k) samples where a peak may lie.
        least: (P,) or scalar, the height that a peak must reach.
        most: peaks of a curve at most.

    Returns:
        Rows (n,), positions (n,) in samples and heights (n,), row by row, highest first.
    """
    floor = np.broadcast_to(np.asarray(least, float), curves.shape[:1])
    row, at = np.nonzero(local_maxima(curves) & allowed & (curves >= floor[:, None]))
    offset, height = refine(curves[row, at - 1], curves[row, at], curves[row, np.minimum(at + 1, curves.shape[1] - 1)])
    order = np.lexsort((at, -height, row))
    row, position, height = row[order], (at + offset)[order], height[order]
    first = np.searchsorted(row, row)
    kept = np.arange(len(row)) - first < most
    return row[kept], position[kept], height[kept]
