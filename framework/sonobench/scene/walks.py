"""What random walks in a box share: steps drawn from a seed of their own, and mirrors at the walls."""

from __future__ import annotations

import numpy as np

from sonobench.types import Array, read_only


def checked_box(start_m: Array, low_m: Array, high_m: Array) -> tuple[Array, Array, Array]:
    """start (3,), low (2,) and high (2,) as read-only arrays.

    Raises:
        ValueError: the box is empty, or the start lies outside it.
    """
    start = read_only(start_m, shape=(3,), name="start_m")
    low, high = read_only(low_m, shape=(2,), name="low_m"), read_only(high_m, shape=(2,), name="high_m")
    if not (low < high).all() or not ((start[:2] >= low) & (start[:2] <= high)).all():
        raise ValueError(f"start_m {start.tolist()} must lie within the box from low_m {low.tolist()} to high_m {high.tolist()}")
    return start, low, high


def draws(seed: int, steps: int) -> Array:
    """(steps, 2) standard normals; more of them for a longer walk, never others."""
    return np.random.default_rng(seed).standard_normal((steps, 2))


def mirrored(points: Array, low: Array, high: Array) -> Array:
    """Points (…, 2) of an endless floor folded into the box [low, high], as a billiard ball goes: steps keep their length but at the walls."""
    width = high - low
    turn = np.mod(points - low, 2.0 * width)
    return np.asarray(low + np.minimum(turn, 2.0 * width - turn))
