"""What the sensors of one array receive: the mixture of all sources that a simulator propagates, and noise.

A vector sensor has four channels, the pressure and the velocity along its array's three axes. Velocities are scaled by −ρ0 c
(ρ0 the density of air, c the speed of sound): a plane wave s from the direction u (a unit vector towards where it comes from)
reads (s, u s).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import NamedTuple

import numpy as np

from sonobench.errors import InputError
from sonobench.geometry import place
from sonobench.scene.noise import channel_noise, channel_variances
from sonobench.scene.resampling import resampled
from sonobench.scene.scene import Scene
from sonobench.scene.seeds import generator
from sonobench.scene.truth import path, sounding
from sonobench.types import Array

#: (array, rate_hz, elements (M, 3) m in the room, signal (n,), path times (k,) s, path positions (k, 3) m) → (n, M) of microphones;
#: (n, 4 M) of vector sensors, element by element p, vx, vy, vz along the axes of the ROOM
Propagate = Callable[[str, float, Array, Array, Array, Array], Array]

_PATH_STEP_S = 0.01


class Emitted(NamedTuple):
    """A source's clean signal: samples (n,) over the whole scene at rate_hz, the band where it has energy, where it comes from."""

    rate_hz: float
    samples: Array
    band_hz: tuple[float, float]
    provenance: Mapping[str, str]


class Ear(NamedTuple):
    """What is recorded as one array: its name, the scene's array that it is or copies, the sources that it hears."""

    name: str
    array: str
    sources: tuple[str, ...]


class Heard(NamedTuple):
    """What an ear records.

    samples (n, channels) with noise; powers: of each source by itself, its mean square of pressure within its own intervals; noise: mean
    squares on the channels of one element, (1,) of a microphone, (4,) of a vector sensor.
    """

    ear: Ear
    samples: Array
    powers: Mapping[str, float]
    noise: Array


def ears_of(scene: Scene, isolated: bool) -> list[Ear]:
    """The arrays of a scene; isolated: a copy ARRAY/SOURCE of every array for every source."""
    if not isolated:
        return [Ear(name, name, tuple(scene.sources)) for name in scene.arrays]
    return [Ear(f"{array}/{source}", array, (source,)) for array in scene.arrays for source in scene.sources]


def receive(scene: Scene, seed: int, ear: Ear, emitted: Mapping[str, Emitted], propagate: Propagate) -> Heard:
    """Propagate and mix what an ear hears, in the array's frame, and add noise.

    Raises:
        InputError: `propagate` returns a wrong shape or NaN.
    """
    table, rate_hz = scene.arrays[ear.array], scene.rate_of(ear.array)
    n, per_element = round(scene.duration_s * rate_hz), 4 if table.kind == "avs" else 1
    elements = place(table.pose, table.elements_m)
    time_s = np.linspace(0.0, scene.duration_s, max(2, round(scene.duration_s / _PATH_STEP_S) + 1))
    mixture, powers = np.zeros((n, per_element * len(elements))), {}
    for name in ear.sources:
        signal = _fitted(resampled(emitted[name].samples, emitted[name].rate_hz, rate_hz), n)
        one = propagate(ear.array, rate_hz, elements, signal, time_s, path(scene.sources[name], scene.duration_s, time_s))
        if np.shape(one) != mixture.shape or not np.isfinite(one).all():
            what = type(scene.simulator).__name__
            raise InputError(f"{what} returned {np.shape(one)} samples of {name} at {ear.array}; finite {mixture.shape} are needed")
        powers[name] = mixture_power(scene, one[:, ::per_element], rate_hz, [name])
        mixture += one
    if per_element == 4:
        mixture = _turned(mixture, table.pose[:3, :3])
    if scene.noise is None:
        return Heard(ear, mixture, powers, np.zeros(per_element))
    if scene.noise.against == "source":
        power = float(np.mean(list(powers.values())))
    else:
        power = mixture_power(scene, mixture[:, ::per_element], rate_hz, ear.sources)
    variances = channel_variances(scene.noise, table.kind, power)
    noise = channel_noise(generator(seed, f"noise/{ear.name}"), scene.noise, variances, mixture.shape, rate_hz)
    return Heard(ear, mixture + noise, powers, variances)


def mixture_power(scene: Scene, mixture: Array, rate_hz: float, sources: Collection[str] | None = None) -> float:
    """Mean square of a noise-free mixture (n, M) over its microphones and the samples within an interval of any of `sources` (None: all)."""
    time_s = np.arange(len(mixture)) / rate_hz
    heard = scene.sources if sources is None else sources
    active = np.any([sounding(scene.sources[name], scene.duration_s, time_s) for name in heard], axis=0)
    return float(np.mean(np.square(mixture[active]))) if active.any() else 0.0


def sensor_parameters(scene: Scene, heard: Collection[Heard]) -> dict[str, float]:
    """What metrics may want of the first array of vector sensors (its first element): {} where there is none.

    origin_x_m, origin_y_m, origin_z_m where it is in the room, origin_yaw_rad, origin_pitch_rad, origin_roll_rad how its array is turned;
    snapshots: samples an evaluation period; source_variance: mean square of a source's pressure there within its intervals, the mean over the
    sources, and source_variance_LABEL of each; pressure_noise_variance; velocity_noise_variance, the mean over the axes, and
    velocity_noise_variance_x, _y, _z; noise_correlation_px, … of two channels, where the noise is correlated.
    """
    first = next((h for h in heard if scene.arrays[h.ear.array].kind == "avs"), None)
    if first is None:
        return {}
    table = scene.arrays[first.ear.array]
    label = dict(zip(scene.sources, scene.labels, strict=True))
    return {
        **dict(zip(("origin_x_m", "origin_y_m", "origin_z_m"), place(table.pose, table.elements_m)[0].tolist(), strict=True)),
        **{f"origin_{turn}_rad": float(np.deg2rad(getattr(table, f"{turn}_deg"))) for turn in ("yaw", "pitch", "roll")},
        "snapshots": float(round(scene.period_s * scene.rate_of(first.ear.array))),
        "source_variance": float(np.mean(list(first.powers.values()))),
        **{f"source_variance_{label[name]}": power for name, power in first.powers.items()},
        "pressure_noise_variance": float(first.noise[0]),
        "velocity_noise_variance": float(np.mean(first.noise[1:])),
        **{f"velocity_noise_variance_{axis}": float(v) for axis, v in zip("xyz", first.noise[1:], strict=True)},
        **_correlations(scene),
    }


def _correlations(scene: Scene) -> dict[str, float]:
    c = None if scene.noise is None else scene.noise.correlation
    return {} if c is None else {f"noise_correlation_{'pxyz'[i]}{'pxyz'[j]}": float(c[i, j]) for i in range(4) for j in range(i + 1, 4)}


def _turned(samples: Array, rotation: Array) -> Array:
    """Samples (n, 4 M) along the room's axes, along those of an array that `rotation` (3, 3) room ← array has turned."""
    if np.array_equal(rotation, np.eye(3)):
        return samples
    by_element = samples.reshape(len(samples), -1, 4)
    return np.concatenate([by_element[..., :1], by_element[..., 1:] @ rotation], axis=-1).reshape(samples.shape)


def _fitted(samples: Array, n: int) -> Array:
    return samples[:n] if len(samples) >= n else np.concatenate([samples, np.zeros(n - len(samples))])
