"""Delays or positions without audio: detections of the targets, missed ones, Gaussian errors, uniform clutter.

Each scan holds, for every target that exists, with probability `p_d` its delays with independent Gaussian errors, and a
Poisson number of false measurements uniform over the delays that a pair can have. "stacked": the pairs of an array are
ONE sensor; a detection is one vector of all its delays (association across pairs is given), and so is a false one.
"per-pair": every pair is a sensor, detected and cluttered by itself. Sensors are named as the bundled front ends name
theirs, "stack" (with several arrays "stack-ARRAY") and "pair-0", "pair-1", …. "position": every array is a sensor of kind "position", named
"position" (with several arrays "position-ARRAY"), that measures where targets are in the room, whatever its own place; clutter is uniform over
the floor of the scene's room, or in free field over `region_m`, which then is the header's box.
Scans come at the multiples 1, 2, … of the scene's `period_s`, frame 1 one period after the start; rows stand in random order. The header's nominal
values p_d, clutter_per_scan and delay_std_s or position_std_m are those used here unless the scene's `nominal` says otherwise.

Source: Vo & Ma 2006 (the standard measurement model, of positions); Ma, Vo, Singh & Baddeley 2006 (delays of microphone pairs).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sonobench.errors import TableError
from sonobench.geometry import lift, max_delay, pair_delays, place
from sonobench.protocols import Rendering
from sonobench.scene import Scene
from sonobench.scene.render import box_of, provenance
from sonobench.scene.seeds import generator
from sonobench.scene.truth import given_of, truth_of
from sonobench.types import Array, Detections, Header, Scan, Sensor, Space, read_only

_AXES = ("x_m", "y_m", "z_m")


@dataclass(frozen=True, eq=False)
class Measurements:
    """Scans of delays or positions straight from the truth."""

    needs_sound: ClassVar[bool] = False
    p_d: float  #: probability of detection, of a target by a sensor in a scan
    clutter_per_scan: float  #: mean number of false measurements a sensor and scan
    delay_std_s: float | None = None  #: of each delay's error; needed but for layout "position"
    layout: Literal["stacked", "per-pair", "position"] = (
        "stacked"  #: one sensor an array, or one a pair; "position": one an array, of positions
    )
    position_std_m: float | None = None  #: of each coordinate's error; needed for layout "position"
    region_m: Array | None = None  #: (2, 2 or 3) corners of the region of false positions; for layout "position" in free field

    def __post_init__(self) -> None:
        found = [] if 0 <= self.p_d <= 1 else [f"p_d: is {self.p_d}; a probability is needed"]
        own, other = ("position_std_m", "delay_std_s") if self.layout == "position" else ("delay_std_s", "position_std_m")
        found += [
            f"{name}: is {getattr(self, name)}; 0 or more is needed"
            for name in (own, "clutter_per_scan")
            if getattr(self, name) is None or not 0 <= getattr(self, name) < np.inf
        ]
        unread = (other, "region_m") if own == "delay_std_s" else (other,)
        found += [f"{name}: layout {self.layout!r} does not read it" for name in unread if getattr(self, name) is not None]
        if self.region_m is not None:
            corners = np.asarray(self.region_m, float)
            if corners.ndim != 2 or len(corners) != 2 or corners.shape[1] not in (2, 3) or not (corners[0] < corners[1]).all():
                found.append(f"region_m: is {corners.tolist()}; two corners, the lower one first, in 2 or 3 dimensions are needed")
            object.__setattr__(self, "region_m", read_only(corners))
        if found:
            raise TableError(found)

    def simulate(self, scene: Scene, seed: int) -> Rendering:
        """Header, scans and truth of a scene.

        Raises:
            TableError: an array without pairs where delays are measured; no region, or two, where positions are.
            InputError: a negative seed.
        """
        box_m, reflections = box_of(scene)
        if self.layout == "position":
            box_m = self._region(box_m)
        sensors = self._sensors(scene)
        truth = truth_of(scene)
        rng = generator(seed, "measurements")
        scans = [
            Scan(float(t), np.ones(len(sensors), bool), self._detections(rng, scene, sensors, truth.position[k][truth.exists[k]], box_m))
            for k, t in enumerate(truth.time_s)
        ]
        error = {"position_std_m": self.position_std_m, "delay_std_s": self.delay_std_s}
        header = Header(
            name=f"{scene.name or 'scene'}@{seed}",
            poses=np.stack([a.pose for a in scene.arrays.values()]),
            sensors=sensors,
            array_names=tuple(scene.arrays),
            duration_s=scene.duration_s,
            period_s=scene.period_s,
            c_m_s=scene.c_m_s,
            box_m=box_m,
            reflections=reflections,
            nominal={
                "p_d": self.p_d,
                "clutter_per_scan": self.clutter_per_scan,
                **{name: value for name, value in error.items() if value is not None},
                **scene.nominal,
            },
            given=given_of(scene, seed),
        )
        return Rendering(header, (), tuple(scans), truth, {}, provenance(scene, seed, {}))

    def _region(self, room_m: Array | None) -> Array:
        """Corners (2, 3) of the box over which false positions are spread; a planar region has no height."""
        if (room_m is None) == (self.region_m is None):
            raise TableError(
                [
                    "simulator.region_m: false positions are spread over the floor of a room, or in free field over region_m; write one of both"
                ]
            )
        if room_m is not None or self.region_m is None:
            return np.asarray(room_m)
        return np.asarray(lift(self.region_m, 0.0), np.float64)

    def _sensors(self, scene: Scene) -> tuple[Sensor, ...]:
        if self.layout == "position":
            return tuple(_positions(scene, _AXES[: 2 if self.region_m is None else self.region_m.shape[1]]))
        bare = [name for name, array in scene.arrays.items() if not len(array.pairs)]
        if bare:
            raise TableError([f"arrays.{name}.pairs: is empty; delays are measured between pairs" for name in bare])
        return tuple(_stacks(scene) if self.layout == "stacked" else _pairs(scene))

    def _detections(
        self, rng: np.random.Generator, scene: Scene, sensors: tuple[Sensor, ...], position: Array, box_m: Array | None
    ) -> tuple[Detections, ...]:
        """One set for each number of components; positions (n, 3) of the targets that exist."""
        rows: dict[int, list[tuple[Array, Array]]] = {}
        for q, sensor in enumerate(sensors):
            seen = position[rng.random(len(position)) < self.p_d]
            if self.layout == "position":
                dz, std = len(sensor.space), float(self.position_std_m or 0.0)
                true, (low, high) = seen[:, :dz], np.asarray(box_m)[:, :dz]
            else:
                elements, std = place(scene.arrays[sensor.array].pose, sensor.elements), float(self.delay_std_s or 0.0)
                true = np.asarray(pair_delays(seen, elements, sensor.pairs, scene.c_m_s))
                high = max_delay(elements, sensor.pairs, scene.c_m_s)
                low = -high
            false = rng.uniform(low, high, (rng.poisson(self.clutter_per_scan), len(high)))
            z = rng.permutation(np.concatenate([true + std * rng.standard_normal(true.shape), false]))
            rows.setdefault(len(high), []).append((z, np.full(len(z), q)))
        return tuple(Detections(np.concatenate([z for z, _ in own]), np.concatenate([q for _, q in own])) for own in rows.values())


def _positions(scene: Scene, axes: tuple[str, ...]) -> Iterator[Sensor]:
    for name, array in scene.arrays.items():
        yield Sensor("position" if len(scene.arrays) == 1 else f"position-{name}", name, "position", array.elements_m, Space(axes))


def _stacks(scene: Scene) -> Iterator[Sensor]:
    for name, array in scene.arrays.items():
        space = Space(tuple(f"tau{p}_s" for p in range(len(array.pairs))))
        yield Sensor("stack" if len(scene.arrays) == 1 else f"stack-{name}", name, "tdoa", array.elements_m, space, array.pairs)


def _pairs(scene: Scene) -> Iterator[Sensor]:
    every = [(name, array.elements_m[pair]) for name, array in scene.arrays.items() for pair in array.pairs]
    for p, (name, both) in enumerate(every):
        yield Sensor(f"pair-{p}", name, "tdoa", both, Space.of("tau_s"), np.array([[0, 1]]))
