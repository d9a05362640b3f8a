"""Plane waves at acoustic vector sensors: snapshots (p, vx, vy, vz) of far-field sources in free field.

A source with the signal s(t) that is seen from an element in the direction u reads (s, u s), velocities scaled by −ρ0 c, at whatever
range: nothing decays, nothing is delayed, elements of one array receive the same s. So the power of a source at the sensor is what its
sound and `gain_db` say, at every sensor: `{ use = "white", rms = 1.0 }` with gain_db = 10 has the expected variance 10. Sounds begin and end without fades.
Source: Nehorai & Paldi 1994, "Acoustic vector-sensor array processing", their model of one source for many and for real signals, without delays.
Deviations: directions of samples are read off the path, straight between positions 10 ms apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sonobench.errors import InputError, TableError
from sonobench.protocols import Rendering
from sonobench.scene import Scene
from sonobench.scene.render import assemble
from sonobench.scene.truth import evaluation_times
from sonobench.types import Array


@dataclass(frozen=True)
class AvsSnapshots:
    """Directions and signals, nothing else of acoustics."""

    held: bool = False  #: a source keeps one direction for each evaluation period, that of the period's evaluation time

    def simulate(self, scene: Scene, seed: int) -> Rendering:
        """Render; a pure function of its arguments.

        Raises:
            TableError: a room, or an array that is not of kind "avs".
            InputError: a negative seed, or a source that meets a sensor.
        """
        found = [f'arrays.{n}.kind: is {a.kind!r}; avs-snapshots needs "avs"' for n, a in scene.arrays.items() if a.kind != "avs"]
        if scene.room is not None:
            found.append("room: avs-snapshots renders plane waves in free field; leave the room out, or use image-method")
        if found:
            raise TableError(found)

        def propagate(_: str, rate_hz: float, elements_m: Array, signal: Array, times_s: Array, positions_m: Array) -> Array:
            still = bool((positions_m == positions_m[0]).all())
            where = positions_m[:1] if still else self._positions(scene, rate_hz, len(signal), times_s, positions_m)
            away = where[:, None] - elements_m
            distance = np.linalg.norm(away, axis=-1, keepdims=True)
            if not distance.all():
                raise InputError(f"scene {scene.name}: a source meets a vector sensor, where it has no direction; move one of them")
            u = away / distance
            if self.held and not still:
                u = u[_period(scene, rate_hz, len(signal))]
            out = np.empty((len(signal), len(elements_m), 4))
            out[..., 0] = signal[:, None]
            np.multiply(u, signal[:, None, None], out=out[..., 1:])
            return out.reshape(len(signal), -1)

        return assemble(scene, seed, propagate, vector_sensors=True, fade_s=0.0)

    def _positions(self, scene: Scene, rate_hz: float, n: int, times_s: Array, positions_m: Array) -> Array:
        """(k, 3) m at the evaluation times, or of the n samples."""
        at = evaluation_times(scene.duration_s, scene.period_s, scene.evaluate_at) if self.held else np.arange(n) / rate_hz
        return np.stack([np.interp(at, times_s, axis) for axis in positions_m.T], axis=-1)


def _period(scene: Scene, rate_hz: float, n: int) -> Array:
    """(n,) the evaluation period of each sample; the last goes on to the end."""
    count = len(evaluation_times(scene.duration_s, scene.period_s))
    return np.asarray(np.minimum((np.arange(n) / (scene.period_s * rate_hz) + 1e-9).astype(int), count - 1))
