"""What can be wrong with a scene, each fault a sentence that begins with the path of its key."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from sonobench.errors import SonobenchError
from sonobench.geometry import place
from sonobench.registry import did_you_mean
from sonobench.scene.noise import noise_faults
from sonobench.scene.tables import ArrayTable, Room, Source
from sonobench.scene.truth import GIVEN, GIVEN_COLUMNS, path

if TYPE_CHECKING:
    from sonobench.scene.scene import Scene

_PATH_STEP_S = 0.01
_PATH_POINTS = 1_000_000
_MOST = 1e9  # a day at 8 kHz; more does not fit into memory


def faults(scene: Scene) -> list[str]:
    """Every fault of a scene; [] is a good one."""
    found = [f"{name}: is {getattr(scene, name)}; a positive number is needed" for name in _POSITIVE if not _positive(getattr(scene, name))]
    if _positive(scene.duration_s) and _positive(scene.period_s) and scene.period_s > scene.duration_s:
        found.append(f"period_s: is {scene.period_s}, longer than the scene of {scene.duration_s} s; it would never be evaluated")
    for per_s, unit in ((scene.rate_hz, "samples"), (1 / scene.period_s if scene.period_s else 0.0, "evaluation times")):
        if _positive(scene.duration_s) and _positive(per_s) and scene.duration_s * per_s > _MOST:
            found.append(f"duration_s: {scene.duration_s:g} s are {scene.duration_s * per_s:.3g} {unit}; {_MOST:.0e} is the most")
    if not scene.sources:
        found.append("sources: the scene is empty; write one [sources.NAME] or more")
    if not scene.arrays:
        found.append("arrays: nothing listens; write one [arrays.NAME] or more")
    found += _room(scene.room) if scene.room is not None else []
    for name, array in scene.arrays.items():
        found += [f"arrays.{name}.{fault}" for fault in _array(array, scene.room)]
    for name, source in scene.sources.items():
        found += [f"sources.{name}.{fault}" for fault in _source(source, scene)]
    found += [*_labels(scene), *_clips(scene)]
    if scene.noise is not None:
        found += [f"noise.{fault}" for fault in noise_faults(scene.noise, scene.arrays)]
    for name in scene.given:
        if name not in GIVEN:
            found.append(
                f"given: nothing is known as {name!r}{did_you_mean(name, GIVEN)}; there are {sorted(GIVEN)} (write arrays of your own in [given_arrays])"
            )
    if "snr_db" in scene.given and scene.noise is not None and scene.noise.snr_db is None:
        found.append("given: snr_db is not known where the noise has a variance; leave it out, or write noise.snr_db")
    found += [f"given_arrays.{name}: is also in given; write it once" for name in scene.given_arrays if name in scene.given]
    found += [f"given_std.{fault}" for fault in _given_std(scene)]
    return found


def _given_std(scene: Scene) -> Iterator[str]:
    columns = {
        **{name: GIVEN_COLUMNS[name] for name in scene.given if name in GIVEN_COLUMNS},
        **{name: value.shape[-1] for name, value in scene.given_arrays.items() if value.ndim},
    }
    for name, std in scene.given_std.items():
        if name not in columns:
            yield f"{name}: only what is given can have errors{did_you_mean(name, columns)}; here {sorted(columns) or 'nothing'}"
        elif std.shape != (columns[name],) or not (np.isfinite(std) & (std >= 0)).all():
            yield f"{name}: is {std.tolist()}; {columns[name]} numbers of 0 or more, one a column, are needed"


_POSITIVE = ("duration_s", "rate_hz", "c_m_s", "period_s")


def _positive(value: float) -> bool:
    return 0 < value < np.inf


def _sized(room: Room) -> bool:
    return room.size_m.shape == (3,) and bool((np.isfinite(room.size_m) & (room.size_m > 0)).all())


def _room(room: Room) -> Iterator[str]:
    if not _sized(room):
        yield f"room.size_m: is {room.size_m.tolist()}; three positive lengths are needed"
    if (room.reflections is None) == (room.t60_s is None):
        yield "room: either reflections or t60_s is needed, not both"
    if room.reflections is not None:
        r = room.reflections
        if r.shape != (6,):
            yield f"room.reflections: has shape {r.shape}; six numbers (x0 x1 y0 y1 z0 z1) are needed"
        elif not ((r >= 0) & (r < 1)).all():
            yield f"room.reflections: {r.tolist()} leaves [0, 1)"
    if room.t60_s is not None and not _positive(room.t60_s):
        yield f"room.t60_s: is {room.t60_s}; a positive time is needed (leave the room out for free field)"


def _array(array: ArrayTable, room: Room | None) -> Iterator[str]:
    elements, pairs = array.elements_m, array.pairs
    if elements.ndim != 2 or elements.shape[1:] != (3,) or not len(elements) or not np.isfinite(elements).all():
        yield f"elements_m: has shape {elements.shape}; (k, 3) finite positions, one or more, are needed"
        return
    if array.position_m.shape != (3,) or not np.isfinite(array.position_m).all():
        yield f"position_m: is {array.position_m.tolist()}; three finite numbers are needed"
        return
    if isinstance(array.rate_hz, tuple):
        if len(array.rate_hz) != len(elements):
            yield f"rate_hz: has {len(array.rate_hz)} rates for {len(elements)} microphones"
        if len(set(array.rate_hz)) > 1:
            yield f"rate_hz: {sorted(set(array.rate_hz))} clash; microphones of one array share a clock, so give each rate an array of its own"
    if array.rate_hz is not None and not all(map(_positive, np.atleast_1d(array.rate_hz))):
        yield f"rate_hz: is {array.rate_hz}; a positive number is needed"
    if pairs.size and pairs.shape[1:] != (2,):
        yield f"pairs: has shape {pairs.shape}; (P, 2) indices are needed"
    elif pairs.size:
        wrong = [p.tolist() for p in pairs if not (0 <= p.min() and p.max() < len(elements)) or p[0] == p[1]]
        if wrong:
            yield f"pairs: {wrong} name no two of the elements 0 to {len(elements) - 1}"
    if room is not None and _sized(room):
        where = place(array.pose, elements)
        for i in np.flatnonzero(~_inside(where, room)):
            yield f"elements_m[{i}]: lies at {_point(where[i])} m in the room, outside its {_size(room)}"


def _source(source: Source, scene: Scene) -> Iterator[str]:
    bad = list(_intervals(source, scene.duration_s))
    yield from bad
    if source.sound is None and getattr(scene.simulator, "needs_sound", True):
        yield f"sound: is missing; {type(scene.simulator).__name__} renders sound"
    for problem in _files(source):
        yield f"sound: {problem}"
    if not np.isfinite(source.gain_db):
        yield f"gain_db: is {source.gain_db}; a finite number is needed"
    if scene.room is None or not _sized(scene.room) or bad or not _positive(scene.duration_s):
        return
    time_s = np.linspace(0, scene.duration_s, min(max(2, int(scene.duration_s / _PATH_STEP_S) + 1), _PATH_POINTS))
    where = path(source, scene.duration_s, time_s)
    outside = np.flatnonzero(~_inside(where, scene.room))
    if len(outside):
        first = outside[0]
        yield f"trajectory: at {time_s[first]:.2f} s it is at {_point(where[first])} m, outside the room's {_size(scene.room)}"


def _intervals(source: Source, duration_s: float) -> Iterator[str]:
    spans = source.intervals
    if spans is None or not _positive(duration_s):
        return
    if spans.ndim != 2 or spans.shape[1:] != (2,) or not len(spans):
        yield f"intervals: has shape {spans.shape}; one or more [start, end] are needed"
        return
    for start, end in spans:
        if not start < end:
            yield f"intervals: [{start:g}, {end:g}] ends before it starts"
        elif start < 0 or end > duration_s:
            yield f"intervals: [{start:g}, {end:g}] leaves the scene of 0 to {duration_s:g} s"
    ordered = spans[np.argsort(spans[:, 0])]
    for (a, b), (c, d) in itertools.pairwise(ordered):
        if c < b:
            yield f"intervals: [{a:g}, {b:g}] and [{c:g}, {d:g}] overlap"
    if not np.array_equal(ordered, spans):
        yield "intervals: are out of order; write the earliest first"


def _files(source: Source) -> Iterator[str]:
    try:
        getattr(source.sound, "files", None)
    except SonobenchError as error:
        yield str(error)


def _labels(scene: Scene) -> Iterator[str]:
    labels = scene.labels
    for label in sorted({n for n in labels if labels.count(n) > 1}):
        who = [name for name, own in zip(scene.sources, labels, strict=True) if own == label]
        yield f"sources: {' and '.join(who)} share the label {label}"


def _clips(scene: Scene) -> Iterator[str]:
    users: dict[str, list[str]] = {}
    for name, source in scene.sources.items():
        if not list(_files(source)):
            for file in getattr(source.sound, "files", ())[:1]:
                users.setdefault(str(file.resolve()), []).append(name)
    for file, names in users.items():
        if len(names) > 1:
            yield f"sources: {' and '.join(names)} sound the same clip {file.rsplit('/', 1)[-1]}; give each its own"


def _inside(points: np.ndarray, room: Room) -> np.ndarray:
    return np.asarray(((points >= 0) & (points <= room.size_m)).all(axis=-1))


def _point(point: np.ndarray) -> str:
    return "(" + ", ".join(f"{v:.3g}" for v in point) + ")"


def _size(room: Room) -> str:
    return " × ".join(f"{v:g}" for v in room.size_m) + " m"
