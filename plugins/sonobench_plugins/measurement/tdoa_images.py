"""Delays of one microphone pair with echoes: a talker is heard directly and from its images behind walls, each delay a mode.

    mode (a, b): tau = (|x_a − m_i| − |x_b − m_j|) / c,    x_a the talker or its image behind a wall

First the direct mode, then for each wall: direct at i with the image at j, the image at i with direct at j, and with
`both` the image at both. L = 1 + 2 walls, or 1 + 3 walls.

Source: Liang 2016, eq. 5-35 (five modes, from the walls x = 0 and x = L0).
Deviations: eq. 5-35 is printed with −y² for +y², in metres, and with the opposite sign of delays; the image-image modes are
missing there, which `both` adds. Which modes a recording shows depends on the front end's range of delays: `reach_s` must say it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from sonobench.errors import SetupError
from sonobench.geometry import lift, place
from sonobench.types import Array, Bools, Floats, Scan, Sensor, Setup, Space

Wall = Literal["x0", "x1", "y0", "y1", "z0", "z1"]
_WALLS = ("x0", "x1", "y0", "y1", "z0", "z1")
_MARGIN = 6.0


@dataclass(frozen=True)
class TdoaImages:
    """Direct and echo delays of single pairs; for trackers that take several detections a target."""

    reach_s: float  #: the front end reports delays up to ± this
    walls: tuple[Wall, ...] = ("x0", "x1")  #: walls that echo, named by axis and side of the room's box
    both: bool = False  #: also the delay between the images behind one wall
    sensor: str = ""  #: what the names of the sensors to read begin with; "" reads all of kind "tdoa"
    delay_std_s: float | None = None  #: standard deviation of a delay; None: the recording's nominal delay_std_s
    p_d: float | None = None  #: probability that the direct delay is detected; None: nominal p_d
    p_d_echo: float = 0.4  #: the same of each other mode
    clutter_per_scan: float | None = None  #: mean number of false rows of each sensor and scan; None: nominal
    height_m: float | None = None  #: height of planar states; None: nominal height_m, else 0

    def __post_init__(self) -> None:
        if not self.reach_s > 0 or (self.delay_std_s is not None and not self.delay_std_s > 0):
            raise ValueError(f"reach_s is {self.reach_s} and delay_std_s {self.delay_std_s}; above 0 is needed")
        if not set(self.walls) <= set(_WALLS) or len(set(self.walls)) != len(self.walls):
            raise ValueError(f"walls is {list(self.walls)}; different ones of {list(_WALLS)} are needed")
        if not all(p is None or 0 <= p <= 1 for p in (self.p_d, self.p_d_echo)):
            raise ValueError(f"p_d is {self.p_d} and p_d_echo {self.p_d_echo}; 0 to 1 is needed")
        if self.clutter_per_scan is not None and not self.clutter_per_scan >= 0:
            raise ValueError(f"clutter_per_scan is {self.clutter_per_scan}; at least 0 is needed")

    def bind(self, space: Space, setup: Setup) -> BoundTdoaImages:
        """Look up sensors, positions, walls and nominal values.

        Raises:
            SetupError: no such sensor, one of several pairs, no box, a nominal value or a position missing.
        """
        who = "measurement tdoa-images"
        sensors = tuple(setup.of_kind("tdoa", who, self.sensor))
        several = [setup.sensors[q].name for q in sensors if len(setup.sensors[q].pairs) != 1]
        if several:
            raise SetupError(
                f"{who} reads sensors of one pair each; {several} hold several: set `sensor` to the beginning of the others' names"
            )
        if setup.box_m is None and self.walls:
            raise SetupError(
                f"{who} mirrors talkers in the walls {list(self.walls)}; the recording is in free field or does not say its box"
            )
        axes = [n for n in ("x_m", "y_m", "z_m") if n in space.names or n != "z_m"]
        box_m = np.zeros((2, 3)) if setup.box_m is None else setup.box_m
        axis_of = {wall: "xyz".index(wall[0]) for wall in self.walls}
        return BoundTdoaImages(
            sensors=sensors,
            columns=tuple(space.index(*axes)),
            d=len(space),
            units={q: setup.sensors[q] for q in sensors},
            elements={q: place(setup.pose(setup.sensors[q]), setup.sensors[q].elements) for q in sensors},
            mirrors=tuple((axis_of[wall], float(box_m[int(wall[1]), axis_of[wall]])) for wall in self.walls),
            both=self.both,
            reach_s=self.reach_s,
            c_m_s=setup.c_m_s,
            height_m=setup.nominal.get("height_m", 0.0) if self.height_m is None else self.height_m,
            delay_std_s=setup.value("delay_std_s", self.delay_std_s, who),
            probability=(setup.value("p_d", self.p_d, who), self.p_d_echo),
            clutter_per_scan=setup.value("clutter_per_scan", self.clutter_per_scan, who),
        )


@dataclass(frozen=True, eq=False)
class BoundTdoaImages:
    """`TdoaImages` that knows columns, microphones, mirrors (axis, place in m) and numbers; keys of mappings index Setup.sensors."""

    sensors: tuple[int, ...]
    columns: tuple[int, ...]
    d: int
    units: dict[int, Sensor]
    elements: dict[int, Array]
    mirrors: tuple[tuple[int, float], ...]
    both: bool
    reach_s: float
    c_m_s: float
    height_m: float
    delay_std_s: float
    probability: tuple[float, float]
    clutter_per_scan: float

    @property
    def n_modes(self) -> int:
        """One, and two or three for each wall."""
        return len(self._modes[0])

    @property
    def _modes(self) -> tuple[list[int], list[int]]:
        """Image heard at microphone i, and at j, of each mode; 0 is the talker itself."""
        at_i, at_j = [0], [0]
        for wall in range(1, len(self.mirrors) + 1):
            at_i += [0, wall, wall] if self.both else [0, wall]
            at_j += [wall, 0, wall] if self.both else [wall, 0]
        return at_i, at_j

    def _rays(self, x: Floats, q: int, pose: Array | None) -> tuple[Floats, Floats]:
        """From microphones i and j to the talker and its images, each (…, 1 + walls, 3)."""
        elements = self.elements[q] if pose is None else place(pose, self.units[q].elements)
        i, j = self.units[q].pairs[0]
        source = lift(np.asarray(x)[..., list(self.columns)], self.height_m)
        images = np.repeat(source[..., None, :], 1 + len(self.mirrors), axis=-2)
        for k, (axis, place_m) in enumerate(self.mirrors, 1):
            images[..., k, axis] = 2 * place_m - images[..., k, axis]
        return images - elements[i], images - elements[j]

    def h(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """Delays (…, L, 1) s of states (…, d)."""
        to_i, to_j = (np.sqrt(np.sum(ray**2, axis=-1)) for ray in self._rays(x, q, pose))
        at_i, at_j = self._modes
        return ((to_i[..., at_i] - to_j[..., at_j]) / self.c_m_s)[..., None]

    def jacobian(self, x: Floats, q: int, pose: Array | None = None) -> Floats:
        """d tau / dx (…, L, 1, d); 0 from a talker at a microphone."""
        slopes = []
        for ray in self._rays(x, q, pose):
            length = np.linalg.norm(ray, axis=-1, keepdims=True)
            unit = np.divide(ray, length, out=np.zeros_like(ray), where=length > 0)
            for k, (axis, _) in enumerate(self.mirrors, 1):
                unit[..., k, axis] *= -1.0  # the image moves against the talker
            slopes.append(unit)
        at_i, at_j = self._modes
        slope = (slopes[0][..., at_i, :] - slopes[1][..., at_j, :]) / self.c_m_s
        full = np.zeros((*slope.shape[:-1], 1, self.d))
        full[..., 0, list(self.columns)] = slope[..., : len(self.columns)]
        return full

    def residual(self, z: Floats, z_hat: Floats, q: int) -> Floats:
        """z − ẑ."""
        return self.units[q].space.residual(z, z_hat)

    def R(self, q: int, scan: Scan | None = None) -> Array:
        """delay_std_s² (1, 1)."""
        return np.full((1, 1), self.delay_std_s**2)

    def p_d(self, x: Floats, q: int, scan: Scan | None = None) -> Floats:
        """p_d of the direct mode and p_d_echo of the others (…, L), 0 of a mode whose delay is out of reach."""
        delays = self.h(x, q)[..., 0]
        direct, echo = self.probability
        p = np.full(delays.shape, echo)
        p[..., 0] = direct
        return np.where(np.abs(delays) <= self.reach_s, p, 0.0)

    def log_clutter(self, z: Floats, q: int, valid: Bools | None = None) -> Floats:
        """log(lambda / 2 reach) (…,), −inf where a delay lies beyond reach and six deviations."""
        inside = np.abs(np.asarray(z)[..., 0]) <= self.reach_s + _MARGIN * self.delay_std_s
        if self.clutter_per_scan == 0:
            return np.full(inside.shape, -np.inf)
        return np.where(inside, math.log(self.clutter_per_scan / (2 * self.reach_s)), -np.inf)
