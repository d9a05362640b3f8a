"""Truth and estimates as directions from an array, for metrics: angles between them are angles on the sphere.

The truth's `parameters` name the point that is looked from, origin_x_m, origin_y_m and origin_z_m, by default 0. Directions are in the
room's axes. Estimates hold azimuth_rad and elevation_rad, or x_m, y_m and z_m.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from sonobench.errors import SetupError
from sonobench.geometry import angles, unit_vector
from sonobench.scoring import Targets, aligned
from sonobench.sphere import apart
from sonobench.types import Array, Bools, Estimate, Floats, Space, Truth

_ORIGIN = ("origin_x_m", "origin_y_m", "origin_z_m")
_POINT = ("x_m", "y_m", "z_m")
_ANGLES = ("azimuth_rad", "elevation_rad")


class Look(NamedTuple):
    """One valid evaluation time: directions of the truth (n, 2) and of the estimates (m, 2), and which targets sound (n,)."""

    truth: Array
    estimates: Array
    active: Bools

    def angles(self) -> Array:
        """Angles (n, m) between them, rad."""
        return separations(self.truth[:, None, :], self.estimates[None, :, :])

    def matched(self) -> tuple[Array, Array]:
        """Rows of the truth and of the estimates in the assignment that makes the sum of squared angles least."""
        rows, columns = linear_sum_assignment(self.angles() ** 2)
        return rows, columns


def origin(truth: Truth) -> Array:
    """The point (3,) that directions are seen from, m in the room."""
    return np.array([truth.parameters.get(n, 0.0) for n in _ORIGIN])


def axes(truth: Truth) -> Array:
    """The array's axes in the room (3, 3), room ← array: origin_yaw_rad, origin_pitch_rad and origin_roll_rad of the truth's parameters."""
    from scipy.spatial.transform import Rotation

    turns = [truth.parameters.get(f"origin_{turn}_rad", 0.0) for turn in ("yaw", "pitch", "roll")]
    return np.asarray(Rotation.from_euler("ZYX", turns).as_matrix())


def separations(a: Floats, b: Floats) -> Array:
    """Angles (…,) between directions a and b (…, 2), rad."""
    step = apart(a, b)
    return np.asarray(np.hypot(step[..., 0], step[..., 1]))


def looks(
    truth: Truth, output: Sequence[Estimate], space: Space | None, hold_s: float | None = None, targets: Targets = "exists"
) -> list[Look]:
    """Both sides at every valid evaluation time (see `scoring.aligned`).

    Raises:
        SetupError: the estimates hold neither directions nor positions in space.
    """
    names = _POINT if space is None or set(_POINT) <= set(space.names) else _ANGLES
    if space is not None and not set(names) <= set(space.names):
        raise SetupError(
            f"the metric compares directions; the estimates have {list(space.names)}: {list(_ANGLES)} or {list(_POINT)} are needed"
        )
    place = origin(truth)
    seen = dataclasses.replace(truth, parameters={**truth.parameters, **dict(zip(_ORIGIN, place, strict=True))})
    pairs = aligned(seen, output, space, hold_s, names, targets)
    if names == _ANGLES:
        return [
            Look(f.truth, np.asarray(angles(unit_vector(f.estimates))), f.active) for f in pairs.frames
        ]  # a state may walk over the pole
    return [Look(np.asarray(angles(f.truth - place)), np.asarray(angles(f.estimates - place)), f.active) for f in pairs.frames]


def window(count: int, first_step: int, last_step: int | None) -> Bools:
    """Which of `count` evaluation times, numbered from 1, lie in first_step to last_step."""
    step = np.arange(1, count + 1)
    return np.asarray((step >= first_step) & (step <= (count if last_step is None else last_step)))
