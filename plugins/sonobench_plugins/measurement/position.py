"""Positions measured directly: z = (x, y) or (x, y, z) + Gaussian noise, with clutter spread evenly over a region.

Source: Vo, Singh & Doucet 2005, section V, and Vo & Ma 2006, section IV; Liang 2016, eq. 4-32 and 4-33.
Deviations: Liang gives neither R nor the region. The intensity of clutter holds a little beyond the region, by six deviations of the noise,
or the position measured of a target at its edge could not be clutter, and would count as a target for certain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.errors import SetupError
from sonobench.types import Array, Bools, Floats, Scan, Sensor, Setup, Space, read_only

_MARGIN = 6.0


@dataclass(frozen=True, eq=False)
class Position:
    """Positions in the room; reads sensors of kind "position", each of which names the coordinates that it measures."""

    sensor: str = ""  #: what the names of the sensors to read begin with; "" reads all of kind "position"
    position_std_m: float | None = None  #: standard deviation of each coordinate; None: the recording's nominal position_std_m
    p_d: float | None = None  #: probability that a sensor detects a target; None: nominal p_d
    clutter_per_scan: float | None = None  #: mean number of false rows of each sensor and scan; None: nominal
    region_m: Array | None = None  #: (2, dz) lowest and highest coordinates of clutter; None: the recording's box

    def __post_init__(self) -> None:
        if self.position_std_m is not None and not self.position_std_m > 0:
            raise ValueError(f"position_std_m is {self.position_std_m}; above 0 is needed")
        if self.p_d is not None and not 0 <= self.p_d <= 1:
            raise ValueError(f"p_d is {self.p_d}; 0 to 1 is needed")
        if self.clutter_per_scan is not None and not self.clutter_per_scan >= 0:
            raise ValueError(f"clutter_per_scan is {self.clutter_per_scan}; at least 0 is needed")
        if self.region_m is not None:
            region_m = read_only(self.region_m, shape=(2, None), name="region_m")
            if not (region_m[0] < region_m[1]).all():
                raise ValueError(f"region_m is {region_m.tolist()}; its first row must lie below its second")
            object.__setattr__(self, "region_m", region_m)

    def bind(self, space: Space, setup: Setup) -> BoundPosition:
        """Look up sensors, columns, region and nominal values.

        Raises:
            SetupError: no such sensor, a nominal value, a coordinate or the region is missing.
        """
        who = "measurement position"
        sensors = tuple(setup.of_kind("position", who, self.sensor))
        units = {q: setup.sensors[q] for q in sensors}
        return BoundPosition(
            sensors=sensors,
            units=units,
            columns={q: tuple(space.index(*u.space.names)) for q, u in units.items()},
            regions={q: self._region(u, setup) for q, u in units.items()},
            d=len(space),
            position_std_m=setup.value("position_std_m", self.position_std_m, who),
            probability=setup.value("p_d", self.p_d, who),
            clutter_per_scan=setup.value("clutter_per_scan", self.clutter_per_scan, who),
        )

    def _region(self, unit: Sensor, setup: Setup) -> Array:
        axes = ["x_m", "y_m", "z_m"]
        if not set(unit.space.names) <= set(axes):
            raise SetupError(f"measurement position reads x_m, y_m and z_m; sensor {unit.name} measures {list(unit.space.names)}")
        if self.region_m is not None:
            if self.region_m.shape[1] != len(unit.space):
                raise SetupError(
                    f"measurement position: region_m has {self.region_m.shape[1]} columns, sensor {unit.name} {len(unit.space)}"
                )
            return self.region_m
        if setup.box_m is None:
            raise SetupError("measurement position spreads clutter over a region; the recording has no box: set region_m")
        return setup.box_m[:, [axes.index(n) for n in unit.space.names]]


@dataclass(frozen=True, eq=False)
class BoundPosition:
    """`Position` that knows columns, regions and numbers; keys of the mappings index Setup.sensors."""

    sensors: tuple[int, ...]
    units: dict[int, Sensor]
    columns: dict[int, tuple[int, ...]]
    regions: dict[int, Array]
    d: int
    position_std_m: float
    probability: float
    clutter_per_scan: float

    @property
    def n_modes(self) -> int:
        """One detection a target and sensor."""
        return 1

    def h(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """Positions (…, 1, dz) of states (…, d); in the room, wherever the sensor is."""
        return np.asarray(x)[..., None, list(self.columns[q])]

    def jacobian(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """dz / dx (…, 1, dz, d): rows of the identity."""
        return np.broadcast_to(np.eye(self.d)[list(self.columns[q])], (*np.shape(x)[:-1], 1, len(self.columns[q]), self.d))

    def residual(self, z: Floats, z_hat: Floats, q: int) -> Floats:
        """z − ẑ."""
        return self.units[q].space.residual(z, z_hat)

    def R(self, q: int, scan: Scan | None = None) -> Array:
        """position_std_m² I (dz, dz)."""
        return np.eye(len(self.units[q].space)) * self.position_std_m**2

    def p_d(self, x: Floats, q: int, scan: Scan | None = None) -> Floats:
        """The same everywhere, (…, 1)."""
        return np.full((*np.shape(x)[:-1], 1), self.probability)

    def log_clutter(self, z: Floats, q: int, valid: Bools | None = None) -> Floats:
        """log(lambda / area) (…,) over the components `valid` (dz,), −inf where one lies outside the region and six deviations."""
        used = np.ones(len(self.units[q].space), bool) if valid is None else np.asarray(valid)
        low, high = self.regions[q][:, used]
        rows, margin = np.asarray(z)[..., used], _MARGIN * self.position_std_m
        inside = np.all((rows >= low - margin) & (rows <= high + margin), axis=-1)
        if self.clutter_per_scan == 0:
            return np.full(inside.shape, -np.inf)
        return np.where(inside, math.log(self.clutter_per_scan) - float(np.sum(np.log(high - low))), -np.inf)
