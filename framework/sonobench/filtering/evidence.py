"""What one scan says through one sensor, in an order that its rows' order cannot change."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from sonobench.errors import InputError
from sonobench.protocols import BoundMeasurement
from sonobench.types import Array, Bools, Floats, Ints, Scan


class Rows(NamedTuple):
    """Measurements of one sensor: z (m, dz), R (m, dz, dz) or None (the model's), valid (m, dz), score (m,) or None."""

    z: Array
    R: Array | None
    valid: Bools
    score: Array | None = None


def searched(scan: Scan, sensors: tuple[int, ...]) -> tuple[int, ...]:
    """Those of `sensors` of which the scan holds evidence.

    Raises:
        InputError: the scan is of another setup.
    """
    if sensors and max(sensors) >= len(scan.searched):
        raise InputError(f"the scan at {scan.time_s} s speaks of {len(scan.searched)} sensors, the setup of at least {max(sensors) + 1}")
    return tuple(q for q in sensors if scan.searched[q])


def rows_of(scan: Scan, sensor: int, dz: int) -> Rows:
    """The scan's rows of one sensor, sorted by value; rows without a valid component are left out.

    Raises:
        InputError: rows of another dimension than the sensor's.
    """
    parts = [(g, np.flatnonzero(g.sensor == sensor)) for g in scan.detections]
    parts = [(g, mine) for g, mine in parts if len(mine)]
    if not parts:
        return Rows(np.zeros((0, dz)), None, np.zeros((0, dz), bool))
    if any(g.z.shape[1] != dz for g, _ in parts):
        raise InputError(f"the scan at {scan.time_s} s has rows of {parts[0][0].z.shape[1]} components for sensor {sensor}, which has {dz}")
    if len(parts) > 1:
        raise InputError(f"the scan at {scan.time_s} s lists sensor {sensor} in {len(parts)} sets of detections; give it one")
    group, mine = parts[0]
    z, R = group.z[mine], None if group.R is None else group.R[mine]
    score = None if group.score is None else group.score[mine]
    more = [] if score is None else [score]  # what decides between rows of the same values
    more += [] if R is None else [*R.reshape(len(z), -1).T]
    if group.valid is None:
        order = np.lexsort([*more, *z.T])
        return Rows(z[order], None if R is None else R[order], np.ones(z.shape, bool), None if score is None else score[order])
    valid = group.valid[mine]
    z = np.where(valid, z, 0.0)
    order = np.lexsort([*more, *z.T, *valid.T])
    order = order[valid[order].any(axis=1)]
    return Rows(z[order], None if R is None else R[order], valid[order], None if score is None else score[order])


def noise_of(measurement: BoundMeasurement, scan: Scan, q: int, rows: Rows, which: Ints, z_hat: Floats) -> Array:
    """Noise covariance of rows `which` (m) of a sensor in the axes of their residuals from images ẑ (J, dz).

    Returns:
        (dz, dz) where the model states it for every row, (m, dz, dz) where the rows do, (J, m, dz, dz) where it also depends on ẑ.
    """
    if rows.R is None:
        return measurement.R(q, scan)
    turned = getattr(measurement, "noise", None)
    R = rows.R[which]
    return R if turned is None else np.asarray(turned(R, rows.z[which], z_hat[:, None, :], q))
