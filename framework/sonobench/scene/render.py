"""From a scene to a recording, whatever propagates the sound: what all simulators with audio share.

Every source's sound is rendered once, for as long as its intervals last in all, and laid into them one after the other
with short fades, so that a pause interrupts it. A simulator carries it to the microphones; the mixture gets its noise
and is cut into blocks.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator, Mapping
from fractions import Fraction
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np

from sonobench.errors import InputError, TableError
from sonobench.geometry import place
from sonobench.protocols import Rendering
from sonobench.scene.noise import pink
from sonobench.scene.scene import Scene
from sonobench.scene.seeds import generator
from sonobench.scene.tables import Source
from sonobench.scene.truth import given_of, path, sounding, truth_of
from sonobench.types import Array, Block, Header, MicArray

#: (array, rate_hz, microphones (M, 3) m in the room, signal (n,), path times (k,) s, path positions (k, 3) m) → (n, M)
Propagate = Callable[[str, float, Array, Array, Array, Array], Array]

_FADE_S = 0.01
_PATH_STEP_S = 0.01
_BLOCK_S = 0.1


class Emitted(NamedTuple):
    """A source's clean signal: samples (n,) over the whole scene at rate_hz, the band where it has energy, where it comes from."""

    rate_hz: float
    samples: Array
    band_hz: tuple[float, float]
    provenance: Mapping[str, str]


class _Ear(NamedTuple):
    """What is recorded as one array: its name, the scene's array that it is or copies, the sources that it hears."""

    name: str
    array: str
    sources: tuple[str, ...]


def assemble(scene: Scene, seed: int, propagate: Propagate, isolated: bool = False) -> Rendering:
    """Render sounds, propagate and mix them, add noise; header, truth and provenance beside it.

    Args:
        scene: one whose sources have sounds and whose arrays are of kind "microphones".
        seed: 0 or more; every stream of random numbers derives from it and from what it is for.
        propagate: what the microphones of one array receive of one source. Positions are given every 10 ms.
        isolated: no mixing: every source is heard by its own copy ARRAY/SOURCE of every array, each with noise of its own
            against this source alone.

    Raises:
        TableError: an array of vector sensors, or a source without a sound.
        InputError: a negative seed, or `propagate` returns a wrong shape or NaN.
    """
    _check(scene)
    emitted = {name: emit(scene, name, seed) for name in scene.sources}
    ears = _ears(scene, isolated)
    samples = [_received(scene, seed, ear, emitted, propagate) for ear in ears]
    truth = truth_of(scene, {n: (e.rate_hz, e.samples) for n, e in emitted.items()})
    return Rendering(
        header=_header(scene, seed, ears, [e.band_hz for e in emitted.values()]),
        blocks=tuple(_blocks([(ear.name, scene.rate_of(ear.array), s) for ear, s in zip(ears, samples, strict=True)])),
        scans=(),
        truth=truth,
        sources={n: (e.rate_hz, e.samples.astype(np.float32)) for n, e in emitted.items()},
        provenance=provenance(scene, seed, {n: e.provenance for n, e in emitted.items()}),
    )


def emit(scene: Scene, name: str, seed: int) -> Emitted:
    """The clean signal of one source, at the highest rate of the scene's arrays."""
    source: Source = scene.sources[name]
    rate_hz = max(scene.rate_of(a) for a in scene.arrays)
    edges = np.round(source.spans(scene.duration_s) * rate_hz).astype(int)
    wanted_s = float(np.sum(edges[:, 1] - edges[:, 0]) / rate_hz)
    sound = source.sound.render(generator(seed, f"sound/{name}"), wanted_s, rate_hz)  # type: ignore[union-attr]
    out, used = np.zeros(round(scene.duration_s * rate_hz)), 0
    for start, end in edges:
        piece = sound.samples[used : used + end - start]
        out[start:end] = _faded(piece, rate_hz)
        used += end - start
    return Emitted(rate_hz, out * 10 ** (source.gain_db / 20), sound.band_hz, sound.provenance)


def resampled(samples: Array, from_hz: float, to_hz: float) -> Array:
    """Samples (n,) at another rate: (ceil(n to / from),).

    A linear-phase polyphase filter, flat up to 0.9 of the lower half rate, 80 dB down from that half rate on.
    """
    if from_hz == to_hz:
        return samples
    from scipy.signal import firwin, resample_poly

    ratio = Fraction(to_hz).limit_denominator(1000) / Fraction(from_hz).limit_denominator(1000)
    slower = max(ratio.numerator, ratio.denominator)
    taps = firwin(96 * slower + 1, 0.95 / slower, window=("kaiser", 8.0))
    return np.asarray(resample_poly(samples, ratio.numerator, ratio.denominator, window=taps))


def mixture_power(scene: Scene, mixture: Array, rate_hz: float, sources: Collection[str] | None = None) -> float:
    """Mean square of a noise-free mixture (n, M) over its microphones and the samples within an interval of any of `sources` (None: all)."""
    time_s = np.arange(len(mixture)) / rate_hz
    heard = scene.sources if sources is None else sources
    active = np.any([sounding(scene.sources[name], scene.duration_s, time_s) for name in heard], axis=0)
    return float(np.mean(np.square(mixture[active]))) if active.any() else 0.0


def provenance(scene: Scene, seed: int, sounds: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """Where a rendering comes from: the scene's table, seed, versions, speed of sound, licences and sources of its sounds."""
    return {
        "scene": scene.table,
        "scene_digest": scene.digest(),
        "seed": seed,
        "simulator": type(scene.simulator).__name__,
        "versions": {name: version(name) for name in ("sonobench", "numpy", "scipy")},
        "units": "SI",
        "c_m_s": scene.c_m_s,
        "sounds": {name: dict(p) for name, p in sounds.items()},
    }


def box_of(scene: Scene) -> tuple[Array | None, Array | None]:
    """The header's box_m (2, 3) and reflections (6,); None, None in free field."""
    if scene.room is None:
        return None, None
    return np.stack([np.zeros(3), scene.room.size_m]), scene.room.coefficients(scene.c_m_s)


def _ears(scene: Scene, isolated: bool) -> list[_Ear]:
    if not isolated:
        return [_Ear(name, name, tuple(scene.sources)) for name in scene.arrays]
    return [_Ear(f"{array}/{source}", array, (source,)) for array in scene.arrays for source in scene.sources]


def _check(scene: Scene) -> None:
    found = [f"arrays.{n}.kind: rendering vector sensors comes later; use microphones" for n, a in scene.arrays.items() if a.kind == "avs"]
    found += [f"sources.{n}.sound: is missing; this simulator renders sound" for n, s in scene.sources.items() if s.sound is None]
    if found:
        raise TableError(found)


def _faded(piece: Array, rate_hz: float) -> Array:
    n = min(round(_FADE_S * rate_hz), len(piece) // 2)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / max(n, 1))
    return np.concatenate([piece[:n] * ramp, piece[n : len(piece) - n], piece[len(piece) - n :] * ramp[::-1]])


def _received(scene: Scene, seed: int, ear: _Ear, emitted: Mapping[str, Emitted], propagate: Propagate) -> Array:
    """Samples (n, M) of one recorded array, noise included."""
    rate_hz = scene.rate_of(ear.array)
    n = round(scene.duration_s * rate_hz)
    microphones = place(scene.arrays[ear.array].pose, scene.arrays[ear.array].elements_m)
    time_s = np.linspace(0.0, scene.duration_s, max(2, round(scene.duration_s / _PATH_STEP_S) + 1))
    mixture = np.zeros((n, len(microphones)))
    for name in ear.sources:
        signal = _fitted(resampled(emitted[name].samples, emitted[name].rate_hz, rate_hz), n)
        one = propagate(ear.array, rate_hz, microphones, signal, time_s, path(scene.sources[name], scene.duration_s, time_s))
        if np.shape(one) != mixture.shape or not np.isfinite(one).all():
            what = type(scene.simulator).__name__
            raise InputError(f"{what} returned {np.shape(one)} samples of {name} at {ear.array}; finite {mixture.shape} are needed")
        mixture += one
    return mixture + _noise(scene, seed, ear, mixture, rate_hz)


def _fitted(samples: Array, n: int) -> Array:
    return samples[:n] if len(samples) >= n else np.concatenate([samples, np.zeros(n - len(samples))])


def _noise(scene: Scene, seed: int, ear: _Ear, mixture: Array, rate_hz: float) -> Array:
    if scene.noise is None:
        return np.zeros_like(mixture)
    rng = generator(seed, f"noise/{ear.name}")
    n, microphones = mixture.shape
    if scene.noise.kind == "white":
        noise = rng.standard_normal((n, microphones))
    else:
        noise = np.stack([pink(rng, n, rate_hz) for _ in range(microphones)], axis=1)
    return noise * np.sqrt(mixture_power(scene, mixture, rate_hz, ear.sources) * 10 ** (-scene.noise.snr_db / 10))


def _header(scene: Scene, seed: int, ears: list[_Ear], bands_hz: list[tuple[float, float]]) -> Header:
    low, high = max(b[0] for b in bands_hz), min(b[1] for b in bands_hz)
    box_m, reflections = box_of(scene)
    recorded = [(ear.name, scene.arrays[ear.array], scene.rate_of(ear.array)) for ear in ears]
    return Header(
        name=f"{scene.name or 'scene'}@{seed}",
        arrays=tuple(MicArray(name, a.kind, a.elements_m, rate_hz, a.pairs) for name, a, rate_hz in recorded),
        poses=np.stack([a.pose for _, a, _ in recorded]),
        duration_s=scene.duration_s,
        c_m_s=scene.c_m_s,
        box_m=box_m,
        reflections=reflections,
        band_hz=np.array([low, high]) if low < high else None,
        nominal=scene.nominal,
        given=given_of(scene),
    )


def _blocks(recorded: list[tuple[str, float, Array]]) -> Iterator[Block]:
    """Blocks of about 100 ms of (name, rate, samples), in order of their first sample's time."""
    starts: list[tuple[float, int, int, int]] = []
    for which, (_, rate_hz, channels) in enumerate(recorded):
        edges = np.append(np.arange(0, len(channels), max(1, round(_BLOCK_S * rate_hz))), len(channels))
        starts += [(low / rate_hz, which, int(low), int(high)) for low, high in itertools.pairwise(edges)]
    for _, which, low, high in sorted(starts, key=lambda s: s[0]):
        name, _, channels = recorded[which]
        yield Block(name, low, channels[low:high].astype(np.float32))
