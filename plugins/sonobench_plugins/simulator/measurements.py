"""Time differences of arrival without audio: detections of the targets, missed ones, Gaussian errors, uniform clutter.

Each scan holds, for every target that exists, with probability `p_d` its delays with independent Gaussian errors, and a
Poisson number of false measurements uniform over the delays that a pair can have. "stacked": the pairs of an array are
ONE sensor; a detection is one vector of all its delays (association across pairs is given), and so is a false one.
"per-pair": every pair is a sensor, detected and cluttered by itself. Sensors are named as the bundled front ends name
theirs, "stack" (with several arrays "stack-ARRAY") and "pair-0", "pair-1", …. Scans come at the multiples 1, 2, … of the scene's
`period_s`, frame 1 one period after the start; rows stand in random order. The header's nominal values p_d,
clutter_per_scan and delay_std_s are those used here unless the scene's `nominal` says otherwise.

Source: Vo & Ma 2006 (the standard measurement model); Ma, Vo, Singh & Baddeley 2006 (delays of microphone pairs).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from sonobench.errors import TableError
from sonobench.geometry import max_delay, pair_delays, place
from sonobench.protocols import Rendering
from sonobench.scene import Scene
from sonobench.scene.render import box_of, provenance
from sonobench.scene.seeds import generator
from sonobench.scene.truth import given_of, truth_of
from sonobench.types import Array, Detections, Header, Scan, Sensor, Space


@dataclass(frozen=True)
class Measurements:
    """Scans of delays straight from the truth."""

    needs_sound: ClassVar[bool] = False
    p_d: float  #: probability of detection, of a target by a sensor in a scan
    delay_std_s: float  #: of each delay's error
    clutter_per_scan: float  #: mean number of false measurements a sensor and scan
    layout: Literal["stacked", "per-pair"] = "stacked"  #: one sensor an array, or one a pair

    def __post_init__(self) -> None:
        found = [] if 0 <= self.p_d <= 1 else [f"p_d: is {self.p_d}; a probability is needed"]
        found += [
            f"{name}: is {getattr(self, name)}; 0 or more is needed"
            for name in ("delay_std_s", "clutter_per_scan")
            if not 0 <= getattr(self, name) < np.inf
        ]
        if found:
            raise TableError(found)

    def simulate(self, scene: Scene, seed: int) -> Rendering:
        """Header, scans and truth of a scene.

        Raises:
            TableError: an array without pairs.
            InputError: a negative seed.
        """
        sensors = self._sensors(scene)
        truth = truth_of(scene)
        rng = generator(seed, "measurements")
        scans = [
            Scan(float(time_s), np.ones(len(sensors), bool), self._detections(rng, scene, sensors, truth.position[k][truth.exists[k]]))
            for k, time_s in enumerate(truth.time_s)
        ]
        box_m, reflections = box_of(scene)
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
            nominal={"p_d": self.p_d, "clutter_per_scan": self.clutter_per_scan, "delay_std_s": self.delay_std_s, **scene.nominal},
            given=given_of(scene),
        )
        return Rendering(header, (), tuple(scans), truth, {}, provenance(scene, seed, {}))

    def _sensors(self, scene: Scene) -> tuple[Sensor, ...]:
        bare = [name for name, array in scene.arrays.items() if not len(array.pairs)]
        if bare:
            raise TableError([f"arrays.{name}.pairs: is empty; delays are measured between pairs" for name in bare])
        return tuple(_stacks(scene) if self.layout == "stacked" else _pairs(scene))

    def _detections(self, rng: np.random.Generator, scene: Scene, sensors: tuple[Sensor, ...], position: Array) -> tuple[Detections, ...]:
        """One set for each number of delays; positions (n, 3) of the targets that exist."""
        rows: dict[int, list[tuple[Array, Array]]] = {}
        for q, sensor in enumerate(sensors):
            elements = place(scene.arrays[sensor.array].pose, sensor.elements)
            found = rng.random(len(position)) < self.p_d
            true = pair_delays(position[found], elements, sensor.pairs, scene.c_m_s)
            reach = max_delay(elements, sensor.pairs, scene.c_m_s)
            false = rng.uniform(-reach, reach, (rng.poisson(self.clutter_per_scan), len(reach)))
            z = rng.permutation(np.concatenate([true + self.delay_std_s * rng.standard_normal(true.shape), false]))
            rows.setdefault(len(reach), []).append((z, np.full(len(z), q)))
        return tuple(Detections(np.concatenate([z for z, _ in own]), np.concatenate([q for _, q in own])) for own in rows.values())


def _stacks(scene: Scene) -> Iterator[Sensor]:
    for name, array in scene.arrays.items():
        space = Space(tuple(f"tau{p}_s" for p in range(len(array.pairs))))
        yield Sensor("stack" if len(scene.arrays) == 1 else f"stack-{name}", name, "tdoa", array.elements_m, space, array.pairs)


def _pairs(scene: Scene) -> Iterator[Sensor]:
    every = [(name, array.elements_m[pair]) for name, array in scene.arrays.items() for pair in array.pairs]
    for p, (name, both) in enumerate(every):
        yield Sensor(f"pair-{p}", name, "tdoa", both, Space.of("tau_s"), np.array([[0, 1]]))
