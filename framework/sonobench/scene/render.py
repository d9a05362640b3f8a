"""From a scene to a recording, whatever propagates the sound: what all simulators with audio share.

Every source's sound is rendered once, for as long as its intervals last in all, and laid into them one after the other
with short fades, so that a pause interrupts it. A simulator carries it to the sensors (`reception`); the mixture gets its
noise and is cut into blocks.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import numpy as np

from sonobench.errors import TableError
from sonobench.protocols import Rendering
from sonobench.scene.reception import Ear, Emitted, Propagate, ears_of, receive, sensor_parameters
from sonobench.scene.scene import Scene
from sonobench.scene.seeds import generator
from sonobench.scene.tables import Source
from sonobench.scene.truth import given_of, truth_of
from sonobench.types import Array, Block, Header, MicArray

FADE_S = 0.01
_BLOCK_S = 0.1


def assemble(
    scene: Scene, seed: int, propagate: Propagate, isolated: bool = False, vector_sensors: bool = False, fade_s: float = FADE_S
) -> Rendering:
    """Render sounds, propagate and mix them, add noise; header, truth and provenance beside it.

    Args:
        scene: one whose sources have sounds.
        seed: 0 or more; every stream of random numbers derives from it and from what it is for.
        propagate: what the microphones of one array receive of one source. Positions are given every 10 ms.
        isolated: no mixing: every source is heard by its own copy ARRAY/SOURCE of every array, each with noise of its own
            against this source alone.
        vector_sensors: whether `propagate` knows arrays of kind "avs".
        fade_s: how long a sound comes and goes at the edges of its intervals; 0 for none.

    Raises:
        TableError: an array of vector sensors that this simulator does not render, or a source without a sound.
        InputError: a negative seed, or `propagate` returns a wrong shape or NaN.
    """
    _check(scene, vector_sensors)
    emitted = {name: emit(scene, name, seed, fade_s) for name in scene.sources}
    heard = [receive(scene, seed, ear, emitted, propagate) for ear in ears_of(scene, isolated)]
    truth = truth_of(scene, {n: (e.rate_hz, e.samples) for n, e in emitted.items()})
    truth = replace(truth, parameters={**sensor_parameters(scene, heard), **truth.parameters})
    return Rendering(
        header=_header(scene, seed, [h.ear for h in heard], [e.band_hz for e in emitted.values()]),
        blocks=tuple(_blocks([(h.ear.name, scene.rate_of(h.ear.array), h.samples) for h in heard])),
        scans=(),
        truth=truth,
        sources={n: (e.rate_hz, e.samples.astype(np.float32)) for n, e in emitted.items()},
        provenance=provenance(scene, seed, {n: e.provenance for n, e in emitted.items()}),
    )


def emit(scene: Scene, name: str, seed: int, fade_s: float = FADE_S) -> Emitted:
    """The clean signal of one source, at the highest rate of the scene's arrays."""
    source: Source = scene.sources[name]
    rate_hz = max(scene.rate_of(a) for a in scene.arrays)
    edges = np.round(source.spans(scene.duration_s) * rate_hz).astype(int)
    wanted_s = float(np.sum(edges[:, 1] - edges[:, 0]) / rate_hz)
    sound = source.sound.render(generator(seed, f"sound/{name}"), wanted_s, rate_hz)  # type: ignore[union-attr]
    out, used = np.zeros(round(scene.duration_s * rate_hz)), 0
    for start, end in edges:
        piece = sound.samples[used : used + end - start]
        out[start:end] = _faded(piece, round(fade_s * rate_hz))
        used += end - start
    return Emitted(rate_hz, out * 10 ** (source.gain_db / 20), sound.band_hz, sound.provenance)


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


def _check(scene: Scene, vector_sensors: bool) -> None:
    found = [
        f"arrays.{name}.kind: {type(scene.simulator).__name__} renders pressure alone; vector sensors need image-method or avs-snapshots"
        for name, array in scene.arrays.items()
        if array.kind == "avs" and not vector_sensors
    ]
    found += [f"sources.{n}.sound: is missing; this simulator renders sound" for n, s in scene.sources.items() if s.sound is None]
    if found:
        raise TableError(found)


def _faded(piece: Array, samples: int) -> Array:
    n = min(samples, len(piece) // 2)
    ramp = 0.5 - 0.5 * np.cos(np.pi * (np.arange(n) + 0.5) / max(n, 1))
    return np.concatenate([piece[:n] * ramp, piece[n : len(piece) - n], piece[len(piece) - n :] * ramp[::-1]])


def _header(scene: Scene, seed: int, ears: list[Ear], bands_hz: list[tuple[float, float]]) -> Header:
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
        given=given_of(scene, seed),
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
