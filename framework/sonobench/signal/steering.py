"""Steered response power: at any point the sum over pairs of delay tables at the delays that the point would have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sonobench.geometry import sensor_delays
from sonobench.types import Array, Field, Floats, Setup


def steered_power(table: Field, setup: Setup, points: Floats, sensors: Sequence[int] | None = None) -> Array:
    """Steered response power (…,) at points (…, 3) m, or (…, 2) at the setup's nominal `height_m`.

    Args:
        table: a field over delay, such as the front ends' "gcc".
        setup: the sensors that it is indexed by.
        points: where to steer.
        sensors: single-pair "tdoa" sensors to sum over; by default all of them.

    Raises:
        SetupError: the setup has no "tdoa" sensor.

    Source: DiBiase 2000, SRP-PHAT.
    """
    if sensors is None:
        sensors = [q for q in setup.of_kind("tdoa", "steered_power") if len(setup.sensors[q].space) == 1]
    points = np.asarray(points, float)
    power = np.zeros(points.shape[:-1])
    for q in sensors:
        power += table.at(sensor_delays(points, setup, q)[..., None, :], np.array([q]))[..., 0]
    return power


def grid(box_m: Array, step_m: float, height_m: float | None) -> Array:
    """Points (G, 3) at the centres of equal cells of at most step_m that fill a box; one layer at height_m unless None."""
    low, high = box_m
    axes = [_centres(low[a], high[a], step_m) for a in range(2)]
    axes.append(_centres(low[2], high[2], step_m) if height_m is None else np.array([height_m]))
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _centres(low: float, high: float, step: float) -> Array:
    cells = max(1, int(np.ceil((high - low) / step - 1e-9)))
    return low + (np.arange(cells) + 0.5) * (high - low) / cells
