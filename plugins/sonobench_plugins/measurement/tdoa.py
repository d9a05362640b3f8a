"""Delays between the microphones of pairs: tau = (|x − m_i| − |x − m_j|) / c, with Gaussian noise and uniform clutter.

Source: Chen, Chen, Yin & Hou 2012, eq. 38, 39 and 43.
Deviations: the paper's clutter intensity lambda·V·u is a pure number used as a density. Here it is lambda / V per second
to the power of the number of pairs, V = Π 2 tau_max; `clutter_intensity = "count"` is the paper's, which next to likelihoods in
s⁻⁴ makes clutter all but impossible, so that false detections far out are taken for talkers. The intensity holds a little beyond ±tau_max, by six deviations of the noise,
or a delay measured of a talker at the end of a pair's axis could not be clutter, and would count as a talker for certain.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import SetupError
from sonobench.geometry import lift, max_delay, pair_delays, place
from sonobench.types import Array, Bools, Floats, Scan, Sensor, Setup, Space

_MARGIN = 6.0


@dataclass(frozen=True)
class Tdoa:
    """Delays of microphone pairs, stacked (one sensor of several pairs) or one sensor a pair."""

    sensor: str = ""  #: what the names of the sensors to read begin with; "" reads all of kind "tdoa"
    delay_std_s: float | None = None  #: standard deviation of a delay; None: the recording's nominal delay_std_s
    p_d: float | None = None  #: probability that a sensor detects a talker; None: nominal p_d
    clutter_per_scan: float | None = None  #: mean number of false rows of each sensor and scan; None: nominal
    height_m: float | None = None  #: height of planar states; None: nominal height_m, else 0
    clutter_intensity: Literal["density", "count"] = "density"  #: "count": lambda itself, as Chen et al. 2012 print it

    def __post_init__(self) -> None:
        if self.clutter_intensity not in ("density", "count"):
            raise ValueError(f"clutter_intensity is {self.clutter_intensity!r}; 'density' or 'count' is needed")
        if self.delay_std_s is not None and not self.delay_std_s > 0:
            raise ValueError(f"delay_std_s is {self.delay_std_s}; above 0 is needed")
        if self.p_d is not None and not 0 <= self.p_d <= 1:
            raise ValueError(f"p_d is {self.p_d}; 0 to 1 is needed")
        if self.clutter_per_scan is not None and not self.clutter_per_scan >= 0:
            raise ValueError(f"clutter_per_scan is {self.clutter_per_scan}; at least 0 is needed")

    def bind(self, space: Space, setup: Setup) -> BoundTdoa:
        """Look up sensors, positions and nominal values.

        Raises:
            SetupError: no such sensor, a pair in two of the sensors, a nominal value or a position missing.
        """
        who = "measurement tdoa"
        sensors = tuple(setup.of_kind("tdoa", who, self.sensor))
        _refuse_shared_pairs(setup, sensors, self.sensor)
        units = [setup.sensors[q] for q in sensors]
        elements = [place(setup.pose(u), u.elements) for u in units]
        axes = [n for n in ("x_m", "y_m", "z_m") if n in space.names or n != "z_m"]
        height_m = setup.nominal.get("height_m", 0.0) if self.height_m is None else self.height_m
        return BoundTdoa(
            sensors=sensors,
            columns=tuple(space.index(*axes)),
            d=len(space),
            units=dict(zip(sensors, units, strict=True)),
            elements=dict(zip(sensors, elements, strict=True)),
            tau_max={q: max_delay(e, u.pairs, setup.c_m_s) for q, u, e in zip(sensors, units, elements, strict=True)},
            c_m_s=setup.c_m_s,
            height_m=height_m,
            delay_std_s=setup.value("delay_std_s", self.delay_std_s, who),
            probability=setup.value("p_d", self.p_d, who),
            clutter_per_scan=setup.value("clutter_per_scan", self.clutter_per_scan, who),
            is_density=self.clutter_intensity == "density",
        )


def _refuse_shared_pairs(setup: Setup, sensors: tuple[int, ...], prefix: str) -> None:
    """One pair in two sensors (a stack and its single pairs) would count its evidence twice."""
    seen: dict[tuple[object, ...], str] = {}
    for q in sensors:
        unit = setup.sensors[q]
        for i, j in unit.pairs:
            key = (unit.array, *sorted([unit.elements[i].tobytes(), unit.elements[j].tobytes()]))
            if key in seen and seen[key] != unit.name:
                names = [setup.sensors[s].name for s in sensors]
                raise SetupError(
                    f"measurement tdoa, sensor = {prefix!r}, reads {names}, of which {seen[key]} and {unit.name} hold the same "
                    "microphone pair; set `sensor` to the beginning of the names of one grouping"
                )
            seen[key] = unit.name


@dataclass(frozen=True, eq=False)
class BoundTdoa:
    """`Tdoa` that knows columns, microphones in the room and numbers; keys of the mappings index Setup.sensors."""

    sensors: tuple[int, ...]
    columns: tuple[int, ...]
    d: int
    units: dict[int, Sensor]
    elements: dict[int, Array]
    tau_max: dict[int, Array]
    c_m_s: float
    height_m: float
    delay_std_s: float
    probability: float
    clutter_per_scan: float
    is_density: bool = True

    @property
    def n_modes(self) -> int:
        """One detection a talker and sensor."""
        return 1

    def _microphones(self, q: int, pose: Array | None) -> Array:
        return self.elements[q] if pose is None else place(pose, self.units[q].elements)

    def h(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """Delays (…, 1, dz) s of states (…, d)."""
        points = lift(np.asarray(x)[..., list(self.columns)], self.height_m)
        return pair_delays(points, self._microphones(q, pose), self.units[q].pairs, self.c_m_s)[..., None, :]

    def jacobian(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """d tau / dx (…, 1, dz, d): the difference of the unit vectors from the pair's microphones, over c (0 at a microphone)."""
        x = np.asarray(x)
        columns = list(self.columns)
        ray = lift(x[..., columns], self.height_m)[..., None, :] - self._microphones(q, pose)
        length = np.linalg.norm(ray, axis=-1, keepdims=True)
        unit = np.divide(ray, length, out=np.zeros_like(ray), where=length > 0)
        pairs = self.units[q].pairs
        slope = (unit[..., pairs[:, 0], :] - unit[..., pairs[:, 1], :]) / self.c_m_s
        full = np.zeros((*x.shape[:-1], 1, len(pairs), self.d))
        full[..., 0, :, :][..., columns] = slope[..., : len(columns)]
        return full

    def residual(self, z: Floats, z_hat: Floats, q: int) -> Floats:
        """z − ẑ."""
        return self.units[q].space.residual(z, z_hat)

    def R(self, q: int, scan: Scan | None = None) -> Array:
        """delay_std_s² I (dz, dz)."""
        return np.eye(len(self.units[q].space)) * self.delay_std_s**2

    def p_d(self, x: Floats, q: int, scan: Scan | None = None) -> Floats:
        """The same everywhere, (…, 1)."""
        return np.full((*np.shape(x)[:-1], 1), self.probability)

    def log_clutter(self, z: Floats, q: int, valid: Bools | None = None) -> Floats:
        """log(lambda / Π 2 tau_max) (…,) over the components `valid` (dz,), −inf where one lies beyond tau_max and six deviations.

        As a count it is log lambda there, whatever is valid.
        """
        used = np.ones(len(self.tau_max[q]), bool) if valid is None else np.asarray(valid)
        limit = self.tau_max[q][used]
        inside = np.all(np.abs(np.asarray(z)[..., used]) <= limit + _MARGIN * self.delay_std_s, axis=-1)
        if self.clutter_per_scan == 0:
            return np.full(inside.shape, -np.inf)
        log_volume = np.sum(np.log(2 * limit)) if self.is_density else 0.0
        return np.where(inside, math.log(self.clutter_per_scan) - log_volume, -np.inf)
