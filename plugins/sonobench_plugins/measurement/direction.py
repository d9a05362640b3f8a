"""Directions of arrival: azimuth and elevation of a target as a vector sensor hears it, in the axes of its array.

States with x_m, y_m (and z_m) are seen from the sensor's place; states with azimuth_rad and elevation_rad are directions already,
in the room's axes, and are turned into the array's. A state whose elevation has grown beyond ±90° has walked over the pole.

Angles are what sensors measure and rows hold, but nothing is computed with differences of angles: the residual is the step on the
sphere from ẑ to z, east and north in rad of arc (`sonobench.sphere`), and the Jacobian, the model's R and the clutter
intensity (per steradian) are in the same axes. So azimuth wraps, its variance grows by 1 / cos² of the elevation, a sigma point on
the other side of a pole is near its neighbours, and near the horizon all is as in angles. What rows state for their own (azimuth,
elevation) is carried into these axes.
Source: Hu, Li & Jin 2014, eq. 1, 12 and 22 to 25; Hauberg, Lauze & Pedersen 2013, "Unscented Kalman filtering on Riemannian
manifolds".
Deviations: eq. 13 and 24 take differences of angles, which fail at the zenith and at azimuth ±180°.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.errors import InputError, SetupError
from sonobench.geometry import angles, lift, place, unit_vector
from sonobench.sphere import apart, carried, moved, tangents
from sonobench.types import Array, Bools, Floats, Scan, Sensor, Setup, Space

_ANGLES = ("azimuth_rad", "elevation_rad")


@dataclass(frozen=True)
class Direction:
    """Azimuth and elevation; reads sensors of kind "direction"."""

    sensor: str = ""  #: what the names of the sensors to read begin with; "" reads all of kind "direction"
    direction_std_rad: float | None = None  #: deviation along each of two axes on the sphere, of rows without a covariance; None: nominal
    p_d: float | None = None  #: probability that a sensor detects a target; None: nominal p_d, else 1
    clutter_per_scan: float | None = (
        None  #: mean number of false rows of each sensor and scan, uniform on the sphere; None: nominal, else 0
    )
    height_m: float | None = None  #: height of planar states; None: nominal height_m, else 0

    def __post_init__(self) -> None:
        if self.direction_std_rad is not None and not self.direction_std_rad > 0:
            raise ValueError(f"direction_std_rad is {self.direction_std_rad}; above 0 is needed")
        if self.p_d is not None and not 0 <= self.p_d <= 1:
            raise ValueError(f"p_d is {self.p_d}; 0 to 1 is needed")
        if self.clutter_per_scan is not None and not self.clutter_per_scan >= 0:
            raise ValueError(f"clutter_per_scan is {self.clutter_per_scan}; at least 0 is needed")

    def bind(self, space: Space, setup: Setup) -> BoundDirection:
        """Look up sensors, columns and nominal values.

        Raises:
            SetupError: no such sensor, one of another space, or states that hold neither a position nor a direction.
        """
        who = "measurement direction"
        sensors = tuple(setup.of_kind("direction", who, self.sensor))
        for q in sensors:
            if setup.sensors[q].space.names != _ANGLES:
                raise SetupError(
                    f"{who} reads {list(_ANGLES)}; sensor {setup.sensors[q].name} measures {list(setup.sensors[q].space.names)}"
                )
        angular = set(_ANGLES) <= set(space.names)
        if not angular and not {"x_m", "y_m"} <= set(space.names):
            raise SetupError(f"{who} sees states with x_m and y_m, or with azimuth_rad and elevation_rad; these have {list(space.names)}")
        names = _ANGLES if angular else tuple(n for n in ("x_m", "y_m", "z_m") if n in space.names)
        nominal = setup.nominal
        return BoundDirection(
            sensors=sensors,
            units={q: setup.sensors[q] for q in sensors},
            poses={q: setup.pose(setup.sensors[q]) for q in sensors},
            columns=tuple(space.index(*names)),
            d=len(space),
            angular=angular,
            height_m=nominal.get("height_m", 0.0) if self.height_m is None else self.height_m,
            direction_std_rad=nominal.get("direction_std_rad") if self.direction_std_rad is None else self.direction_std_rad,
            probability=nominal.get("p_d", 1.0) if self.p_d is None else self.p_d,
            clutter_per_scan=nominal.get("clutter_per_scan", 0.0) if self.clutter_per_scan is None else self.clutter_per_scan,
        )


@dataclass(frozen=True, eq=False)
class BoundDirection:
    """`Direction` that knows columns, places and numbers; keys of the mappings index Setup.sensors."""

    sensors: tuple[int, ...]
    units: dict[int, Sensor]
    poses: dict[int, Array]
    columns: tuple[int, ...]
    d: int
    angular: bool
    height_m: float
    direction_std_rad: float | None
    probability: float
    clutter_per_scan: float

    @property
    def n_modes(self) -> int:
        """One detection a target and sensor."""
        return 1

    def _ray(self, x: Floats, q: int, pose: Array | None) -> tuple[Array, Array]:
        """Vectors (…, 3) towards the target in the array's frame, and their slope (…, 3, columns)."""
        pose = self.poses[q] if pose is None else np.asarray(pose)
        turn = pose[:3, :3].T
        part = np.asarray(x, float)[..., list(self.columns)]
        if not self.angular:
            offset = lift(part, self.height_m) - place(pose, self.units[q].elements[0])
            return offset @ turn.T, np.broadcast_to(turn[:, : len(self.columns)], (*part.shape[:-1], 3, len(self.columns)))
        slope = tangents(part)
        slope[..., 0, :] *= np.cos(part[..., 1:])
        return unit_vector(part) @ turn.T, np.asarray(turn @ np.swapaxes(slope, -1, -2))

    def h(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """Azimuth and elevation (…, 1, 2) of states (…, d)."""
        return np.asarray(angles(self._ray(x, q, pose)[0]))[..., None, :]

    def jacobian(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """Steps east and north (rad) per unit of the state (…, 1, 2, d); 0 at the sensor itself."""
        ray, slope = self._ray(x, q, pose)
        distance = np.linalg.norm(ray, axis=-1)[..., None, None]
        steps = tangents(angles(ray)) @ slope
        full = np.zeros((*np.shape(x)[:-1], 1, 2, self.d))
        full[..., 0, :, :][..., list(self.columns)] = np.divide(steps, distance, out=np.zeros_like(steps), where=distance > 0)
        return full

    def residual(self, z: Floats, z_hat: Floats, q: int) -> Floats:
        """The step (…, 2), east and north in rad, from ẑ to z on their great circle."""
        return apart(z, z_hat)

    def moved(self, z_hat: Floats, step: Floats, q: int) -> Floats:
        """The direction (…, 2) that a step (…, 2) leads to."""
        return moved(z_hat, step)

    def noise(self, R: Floats, z: Floats, z_hat: Floats, q: int) -> Floats:
        """Covariances (…, 2, 2) of the angles of rows z as those of their residuals from ẑ."""
        return carried(R, z, z_hat)

    def R(self, q: int, scan: Scan | None = None) -> Array:
        """direction_std_rad² I (2, 2), east and north.

        Raises:
            InputError: it was neither set nor nominal, and is asked for.
        """
        if self.direction_std_rad is None:
            raise InputError(
                f"measurement direction: the rows of sensor {self.units[q].name} state no covariance, and the recording has no nominal "
                "direction_std_rad; set direction_std_rad"
            )
        return np.eye(2) * self.direction_std_rad**2

    def p_d(self, x: Floats, q: int, scan: Scan | None = None) -> Floats:
        """The same everywhere, (…, 1)."""
        return np.full((*np.shape(x)[:-1], 1), self.probability)

    def log_clutter(self, z: Floats, q: int, valid: Bools | None = None) -> Floats:
        """log(lambda / 4 pi) (…,), per steradian.

        Raises:
            InputError: a row holds only one of the angles.
        """
        if valid is not None and not np.all(valid):
            raise InputError(
                f"measurement direction: a row of sensor {self.units[q].name} holds only one of {list(_ANGLES)}; both are needed"
            )
        rate = self.clutter_per_scan
        return np.full(np.shape(z)[:-1], math.log(rate / (4 * math.pi)) if rate > 0 else -np.inf)
