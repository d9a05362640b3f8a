"""Steered response power: at any point the sum over pairs of delay tables at the delays that the point would have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sonobench.geometry import place, sensor_delays
from sonobench.types import Array, DelayTable, Field, Floats, Ints, Scan, Setup


@dataclass(frozen=True, slots=True, eq=False)
class Steering:
    """Pairs of microphones in the room, for sums over their delay tables at many points.

    Attributes:
        sensors: (P,) rows of the tables.
        elements: (M, 3) m, each microphone once.
        pairs: (P, 2) rows of `elements`.
        c_m_s: speed of sound.
    """

    sensors: Ints
    elements: Array
    pairs: Ints
    c_m_s: float

    def sums(self, table: DelayTable, points: Floats) -> Array:
        """Sum over the pairs (n,) at points (n, 3) m, tables interpolated linearly."""
        from sonobench.signal._kernels import steer

        points = np.ascontiguousarray(points, float)
        out = np.empty(len(points))
        to_column = np.array([1.0 / (self.c_m_s * table.step_s), -table.start_s / table.step_s])
        steer(table.values[self.sensors], self.elements, self.pairs, points, to_column, out)
        return out


def steering(setup: Setup, sensors: Sequence[int], scan: Scan | None = None) -> Steering:
    """The pairs of single-pair "tdoa" sensors of a setup, where they are at the scan's time."""
    ends = [place(setup.pose(setup.sensors[q], scan), setup.sensors[q].elements)[setup.sensors[q].pairs[0]] for q in sensors]
    elements, index = np.unique(np.concatenate(ends) if ends else np.zeros((0, 3)), axis=0, return_inverse=True)
    return Steering(np.array(sensors, np.int64), elements, np.asarray(index, np.int64).reshape(-1, 2), setup.c_m_s)


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
