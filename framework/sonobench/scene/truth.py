"""What is true in a scene: where its sources are, when they exist, when they sound.

A source exists from the start of its first interval to the end of its last, both included, pauses too. It is active
while one of its intervals lasts and its clean signal is not in a silence of its own: the mean power within ±100 ms lies
above −40 dB of the power of its loudest 100 ms. Without audio it is active during its intervals.
Evaluation times are the ends of the periods of `period_s`, its multiples 1, 2, … up to the scene's end, or where the scene says so their centres.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Literal

import numpy as np

from sonobench.scene.seeds import generator
from sonobench.types import Array, Bools, Truth

if TYPE_CHECKING:
    from sonobench.scene.scene import Scene
    from sonobench.scene.tables import Source

_EDGE_S = 1e-9  # rounding of start + k period
_STEP_S = 1e-5  # of the central difference
_REACH_S = 0.1
_SILENCE = 1e-4  # −40 dB


def evaluation_times(duration_s: float, period_s: float, at: Literal["end", "centre"] = "end") -> Array:
    """(k,) s, one in each period that ends within the duration: period, 2 period, … or half a period before."""
    number = np.arange(1, int(duration_s / period_s + 1e-9) + 1)
    return np.asarray(period_s * (number if at == "end" else number - 0.5), float)


def path(source: Source, duration_s: float, time_s: Array) -> Array:
    """(k, 3) m at scene times (k,); the source waits at the start of its trajectory until its first interval begins."""
    start_s = source.spans(duration_s)[0, 0]
    return np.asarray(source.trajectory.position(np.maximum(np.asarray(time_s) - start_s, 0.0)))


def sounding(source: Source, duration_s: float, time_s: Array) -> Bools:
    """(k,) whether an interval lasts at each time, edges included."""
    spans = source.spans(duration_s)
    t = np.asarray(time_s)[:, None]
    return np.asarray(((t >= spans[:, 0] - _EDGE_S) & (t <= spans[:, 1] + _EDGE_S)).any(axis=1))


def loud(samples: Array, rate_hz: float, time_s: Array) -> Bools:
    """(k,) whether the power of samples (n,) within ±100 ms lies above −40 dB of that of the loudest 100 ms."""
    n, reach = len(samples), max(1, round(_REACH_S * rate_hz))
    energy = np.concatenate([[0.0], np.cumsum(np.square(samples, dtype=float))])
    width = min(reach, n)
    loudest = np.max(energy[width:] - energy[:-width]) / width
    centre = np.round(np.asarray(time_s) * rate_hz).astype(int)
    low, high = np.clip(centre - reach, 0, n), np.clip(centre + reach, 0, n)
    return np.asarray(energy[high] - energy[low] > _SILENCE * loudest * np.maximum(high - low, 1))


def truth_of(scene: Scene, sounds: Mapping[str, tuple[float, Array]] | None = None) -> Truth:
    """The truth of a scene; `sounds` are the clean signals (rate, samples (n,)) by source, None without audio."""
    time_s = evaluation_times(scene.duration_s, scene.period_s, scene.evaluate_at)
    shape = (len(time_s), len(scene.sources))
    position, velocity = np.zeros((*shape, 3)), np.zeros((*shape, 3))
    exists, active = np.zeros(shape, bool), np.zeros(shape, bool)
    for n, (name, source) in enumerate(scene.sources.items()):
        position[:, n], velocity[:, n] = motion(source, scene.duration_s, time_s)
        spans = source.spans(scene.duration_s)
        exists[:, n] = (time_s >= spans[0, 0] - _EDGE_S) & (time_s <= spans[-1, 1] + _EDGE_S)
        active[:, n] = sounding(source, scene.duration_s, time_s)
        if sounds is not None:
            rate_hz, samples = sounds[name]
            active[:, n] &= loud(samples, rate_hz, time_s)
    return Truth(
        time_s=time_s,
        label=np.array(scene.labels, np.int64),
        position=position,
        velocity=velocity,
        exists=exists,
        active=active,
        period_s=scene.period_s,
        parameters=scene.nominal,
    )


def motion(source: Source, duration_s: float, time_s: Array) -> tuple[Array, Array]:
    """Positions (k, 3) m and velocities (k, 3) m/s by central difference, one-sided where the walk begins."""
    start_s = source.spans(duration_s)[0, 0]
    low = np.where(np.abs(time_s - start_s) < _STEP_S, time_s, time_s - _STEP_S)
    high = time_s + _STEP_S
    step = path(source, duration_s, high) - path(source, duration_s, low)
    return path(source, duration_s, time_s), step / (high - low)[:, None]


def _starts(scene: Scene) -> Array:
    rows = []
    for source in scene.sources.values():
        start_s = source.spans(scene.duration_s)[:1, 0]
        position, velocity = motion(source, scene.duration_s, start_s)
        rows.append(np.concatenate([start_s, position[0], velocity[0]]))
    return np.array(rows)


def _births(scene: Scene) -> Array:
    return _starts(scene)[:, 1:4]


def _source_count(scene: Scene) -> Array:
    truth = truth_of(scene)
    return np.stack([truth.time_s, truth.exists.sum(axis=1)], axis=1)


def _activity(scene: Scene) -> Array:
    truth = truth_of(scene)
    return np.concatenate([truth.time_s[:, None], truth.active], axis=1)


def _snr_db(scene: Scene) -> Array:
    return np.array([np.inf if scene.noise is None or scene.noise.snr_db is None else scene.noise.snr_db])


#: what a scene can hand out by name. "starts": (n, 7) rows t, x, y, z, vx, vy, vz of every source's start, SI units;
#: "births": (n, 3) their positions alone; "source_count": (k, 2) rows t, number that exist;
#: "activity": (k, 1 + n) rows t, 1 where an interval of source n lasts; "snr_db": (1,)
GIVEN: Mapping[str, Callable[[Scene], Array]] = {
    "starts": _starts,
    "births": _births,
    "source_count": _source_count,
    "activity": _activity,
    "snr_db": _snr_db,
}


#: columns of what may be handed out with errors
GIVEN_COLUMNS: Mapping[str, int] = {"starts": 7, "births": 3}


def given_of(scene: Scene, seed: int) -> dict[str, Array]:
    """The arrays that the scene hands out to pipelines that ask, with the errors of `given_std` drawn for this seed."""
    exact = {**{name: GIVEN[name](scene) for name in scene.given}, **scene.given_arrays}
    return {name: _with_errors(value, scene.given_std.get(name), seed, name) for name, value in exact.items()}


def _with_errors(value: Array, std: Array | None, seed: int, name: str) -> Array:
    return value if std is None else value + std * generator(seed, f"given/{name}").standard_normal(value.shape)
